"""The sections of a report: photographs, T in pictures, its accuracy, relighting, uses."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.judgement.metrics import relighting_error, unseen_patterns
from lightmatrix.pictures import maps
from lightmatrix.report.elements import (
    Bars,
    Columns,
    Element,
    Gallery,
    Image,
    Section,
    Table,
    Text,
    colour_image,
    difference_image,
    faint_image,
    image_of_map,
    pattern_image,
    photograph,
)
from lightmatrix.report.facts import Facts, Validation
from lightmatrix.reprs import labelled, percent, shown_value
from lightmatrix.rig_model.model import RigModel
from lightmatrix.shape.shape import normal_colours
from lightmatrix.shape.triangulation import triangulate
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.separation import separate


def parameters(facts: Facts) -> Section:
    """The provenance of the estimate, enough to repeat it."""
    rows = tuple(_flat(facts.transport.provenance))
    tables = (Table("The parameters in the store", ("parameter", "value"), rows, True),)
    return Section("parameters", "All parameters", "", tables if rows else ())


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{before}{key}".replace("_", " ")
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}: ")
            continue
        text = shown_value(value)
        # Long values, such as lists of one exposure per frame, are cut.
        yield name, text if len(text) <= 200 else f"{text[:200]} ..."


# What this T can be used for: direct and global light, the shape.

# Larger cameras are left out. This many camera samples (512 x 512) take 11 s of one processor core,
# nearly all of it for the separation, in proportion to their number.
_MOST_SAMPLES = 1 << 18


def uses(facts: Facts) -> Section:
    """Direct and global light, depth and normals."""
    lead = "What this T is good for, under patterns that were never projected."
    transport = facts.transport
    if transport.shape[0] > _MOST_SAMPLES:
        words = (
            "For a camera of this size, use `lightmatrix separate SCENE.zarr -o FOLDER` and "
            "`lightmatrix triangulate SCENE.zarr --geometry GEOMETRY.json -o CLOUD.ply`."
        )
        return Section("uses", "Uses", lead, (Text(words),))
    elements = (*_separated(transport), *_triangulated(transport, facts.geometry))
    return Section("uses", "Uses", lead, elements)


def _separated(transport: LightTransport) -> tuple[Element, ...]:
    """The images of direct and of global light under a white pattern."""
    try:
        parts = separate(transport)
    except InputError as error:
        return (Text(f"Direct and global light cannot be separated: {error.message}."),)
    white = np.ones(transport.projector_shape, np.float32)
    direct, others = parts.direct.relight(white), parts.global_.relight(white)
    share = float(others.sum() / max(float((direct + others).sum()), 1e-12))
    level = float(np.quantile(direct + others, 0.99))
    text = (
        f"Direct light met one surface, global light several: {percent(share)} of the light is "
        "global. `lightmatrix separate` splits T itself, so that both parts can be relit."
    )
    alternative = f"Global light under a white pattern, {percent(share)} of all light"
    images = (
        photograph(direct, "Direct light under a white pattern", "Direct light", white=level),
        photograph(others, alternative, "Global light", "On the same scale.", white=level),
    )
    return Text(text), Gallery(images)


def _triangulated(transport: LightTransport, geometry: RigGeometry | None) -> tuple[Element, ...]:
    """Maps of depth and normals, if the geometry of the rig is known."""
    if geometry is None:
        return ()
    try:
        shape = triangulate(transport, geometry)
    except InputError as error:
        return (Text(f"There is no shape: {error.message}."),)
    if not shape.kept.any():
        return (Text("No camera pixel sees light on its epipolar line, so there is no shape."),)
    summary = shape.summary()
    units = f" {geometry.units}" if geometry.units else ""
    text = (
        f"The surface that the camera sees. {percent(float(shape.kept.mean()))} of the camera "
        f"pixels have a depth; its median is {summary['median_depth']:.4g}{units}, with a standard "
        f"deviation of {summary['median_uncertainty']:.2g}{units}. `lightmatrix triangulate` "
        "writes points, normals and a mesh."
    )
    return Text(text), Gallery(
        (
            image_of_map(shape.depth_map, "Grey: no depth."),
            colour_image(
                normal_colours(shape.camera_normals),
                "Map over the camera of the normals of the surface as colours",
                "Normals",
                "Right, up and towards the camera are red, green and blue. Grey: no normal.",
            ),
        )
    )


def relighting(facts: Facts) -> Section:
    """Relit images, and the errors of T where the truth is known."""
    patterns = unseen_patterns(facts.transport.projector_shape)
    elements: list[Element] = [_relit(facts, name, patterns[name]) for name in ("disc", "stripes")]
    lead = "The scene under patterns that were never projected, without clipping: c = T p."
    if facts.truth is not None:
        shown = np.stack(list(patterns.values()))
        error = relighting_error([facts.transport], [facts.truth], shown)
        lead += f" Mean error of the images: {percent(error)}."
        assert facts.row_errors is not None
        caption = "Error of each camera pixel's rows of T, relative to their size."
        errors = Gallery((image_of_map(maps.error_map(facts.row_errors), caption),))
        values = {"relative_error": facts.relative_error or 0.0}
        if facts.errors is not None:
            values = facts.errors.as_dict()
        rows = tuple((name, shown_value(value)) for name, value in labelled(values).items())
        table = Table("Errors against the truth", ("error", "value"), rows)
        elements.append(Columns((table,), (errors,)))
    return Section("relighting", "Relighting", lead, tuple(elements))


def _relit(facts: Facts, name: str, pattern: np.ndarray) -> Gallery:
    """The scene relit by a pattern, beside the truth where it is known."""
    image = facts.transport.relight(pattern)
    images = [pattern_image(pattern, f"The pattern: {name}", f"Pattern: {name}")]
    if facts.truth is None:
        alternative = f"The relit scene ({name}), computed from T"
        return Gallery((*images, photograph(image, alternative, "The relit scene")))
    known = facts.truth.relight(pattern)
    white = float(np.quantile(known, 0.99))
    error = float(np.linalg.norm(image - known) / max(float(np.linalg.norm(known)), 1e-12))
    images += [
        photograph(image, f"Computed from T: {name}", "Computed from T", white=white),
        photograph(known, f"The truth: {name}", "The truth", white=white),
        difference_image(
            image - known,
            0.01 * white,
            f"Difference: {percent(error)} of the image",
            "Difference",
            f"Relative error of the image: {percent(error)}.",
        ),
    ]
    return Gallery(tuple(images))


def error_estimates(facts: Facts) -> Section:
    """The summary of the estimate, maps of its errors, and predictions beside photographs."""
    summary = labelled(facts.transport.summary(), main_only=True)
    rows = tuple((name, shown_value(value)) for name, value in summary.items())
    table = Table("The estimate", ("property", "value"), rows)
    shown = []
    if maps.has_diagnostic(facts.transport, "estimated_error"):
        caption = "Each camera pixel's own estimate, from its samples and its neighbours."
        shown.append(image_of_map(maps.estimated_error_map(facts.transport), caption))
    # The numbers in the table say all if all rows have converged.
    if np.nanmax(facts.transport.diagnostics.get("gap", 0), initial=0) > 1e-3:
        caption = (
            "How far the objective of each row can be from its optimum. A small gap means solved. "
            "Whether it is right, only unseen photographs can show."
        )
        shown.append(image_of_map(maps.gap_map(facts.transport), caption))
    columns = Columns((table,), (Gallery(tuple(shown)),) if shown else ())
    elements = [columns, *_unseen_photographs(facts)]
    return Section("accuracy", "Accuracy of the estimate", "", tuple(elements))


def _unseen_photographs(facts: Facts) -> list[Element]:
    validation = facts.validation
    if not isinstance(validation, Validation):
        return [Text(f"The estimate was not tested on unseen photographs: {validation}.")]
    where = ""
    if validation.region is not None:
        rows, cols = validation.region
        where = (
            " The camera is large, so only its rows "
            f"{rows.start} to {rows.stop - 1} and columns {cols.start} to {cols.stop - 1} were "
            "tested."
        )
    numbers = ", ".join(map(str, validation.frames))
    words = (
        f"Prediction error on unseen photographs: {percent(validation.error)}; the mean of the "
        f"others, which ignores the pattern, misses them by {percent(validation.mean_error)}. "
        f"Photographs left out ({numbers}) were predicted from their patterns by an estimate from "
        f"the other {validation.others}, which is a little worse than the one described here. "
        f"Samples that clip in both images do not count.{where}"
    )
    number = int(validation.frames[0])
    pattern = facts.capture.patterns.images(number, number + 1)[0]
    seen, predicted = validation.photographs[0], validation.predictions[0]
    # Samples that are not counted or clip in both images do not differ.
    difference = np.where(validation.counted[0], predicted - seen, 0)
    title = f"Photograph {number}"
    mean = float(abs(difference).mean())
    comparison = (
        pattern_image(pattern, f"Pattern {number}", f"Pattern {number}"),
        photograph(seen, title, title, "White is the clip level.", white=1.0),
        photograph(predicted, f"Prediction of photograph {number}", "Its prediction", white=1.0),
        difference_image(
            difference,
            # Three times the usual noise, so that noise does not look like an error.
            0.01,
            f"Difference: {percent(mean)} of the clip level on average",
            "Prediction minus photograph",
            "Grey where they agree.",
        ),
    )
    return [Text(words), Gallery(comparison)]


def photographs(facts: Facts) -> Section:
    """A table of the capture, charts and a map of clipping, and frames."""
    capture = facts.capture
    frames = facts.frames
    images: list[Image] = []
    if "clipped_share" in facts.transport.diagnostics:
        caption = (
            "A clipped sample is a lower bound. A camera pixel that clips in nearly every frame "
            "tells little."
        )
        images.append(image_of_map(maps.clipping_map(facts.transport), caption))
    clipped = percent(float(frames.clipped.mean()))
    decoder, masked = capture.decoder, int((~capture.valid).sum())
    settings: dict[str, object] = {
        **capture.summary(),
        "clipped samples": clipped,
        "response": decoder.response.name,
        "black frame": "subtracted" if decoder.black_frame is not None else "none",
    }
    for device, block in (("camera", capture.bin_camera), ("projector", capture.bin_projector)):
        if block != (1, 1):
            settings[f"{device} binning"] = " x ".join(map(str, block))
    if masked:
        settings["masked camera samples"] = masked
    rows = tuple((name, str(value)) for name, value in settings.items())
    table = Table("The capture", ("property", "value"), rows)
    charts = (
        _bars("Clipped samples per frame", frames.clipped),
        _bars("Mean level per frame, relative to the clip level", frames.level),
    )
    shown = np.unique(np.linspace(0, capture.count - 1, 3).astype(int))
    images += [_frame(facts, int(k)) for k in shown]
    elements = (Columns((table,), charts), *_rig(facts.transport), Gallery(tuple(images)))
    lead = (
        f"The capture has {capture.count} photographs, one per pattern. "
        f"{clipped} of the samples clipped."
    )
    if capture.count > len(shown):
        lead += f" The page shows {len(shown)} of them, spread over the capture."
    return Section("photographs", "Patterns and photographs", lead, elements)


def _rig(transport: LightTransport) -> list[Element]:
    """What the rig did and T is corrected for, with charts of what differs from frame to frame."""
    model = RigModel.of(transport)
    if not model.names:
        return []
    sentences = " ".join(f"{each[0].upper()}{each[1:]}: corrected." for each in model.sentences)
    values = model.values
    charts = []
    if "gain" in values:
        charts.append(_bars("Light per frame, relative to the first", 1 + values["gain"][0]))
    if "ambient" in values:
        more = np.maximum(values["ambient"][0], 0)
        charts.append(_bars("Room light per frame, relative to the clip level", more))
    if "shift" in values:
        far = np.hypot(*values["shift"])
        charts.append(_bars("Displacement per frame, relative to a camera pixel", far))
    return [Text(sentences), *charts]


def _frame(facts: Facts, index: int) -> Image:
    capture, decoder = facts.capture, facts.capture.decoder
    note = f"{percent(float(facts.frames.clipped[index]))} clip"
    if np.ptp(capture.exposures) > 0:
        note += f", exposure {capture.exposures[index]:g}"
    # The frame as linear light, 1 at its clip level, with black not subtracted.
    raw = np.asarray(capture.frame(index), float)
    light = decoder.response.linearise(np.clip(raw / decoder.full_scale, 0, None))
    clip = np.broadcast_to(np.asarray(decoder.clip, float), (capture.count,))[index]
    light = np.asarray(light / decoder.response.linearise(clip / decoder.full_scale))
    return photograph(light, f"Photograph {index}: {note}", f"Photograph {index}", note, white=1.0)


def _bars(title: str, values: NDArray[np.float64]) -> Bars:
    """A chart of one value per frame, or of the largest value of several frames."""
    # A chart has at most 256 bars; of more frames, a bar stands for several.
    starts = np.unique(np.linspace(0, len(values), 257).astype(int)[:-1])
    largest = np.maximum.reduceat(values, starts)
    top = float(largest.max())
    if len(starts) < len(values):
        title += " (each bar: the largest of neighbouring frames)"
    return Bars(
        title,
        f"From {percent(float(values.min()))} to {percent(float(values.max()))}, median "
        f"{percent(float(np.median(values)))}.",
        tuple(float(value) / max(top, 1e-12) for value in largest),
        percent(top),
        len(values) - 1,
    )


def transport_matrix(facts: Facts) -> Section:
    """Pictures of T, from the geometry to single rows and columns."""
    transport = facts.transport
    captions = (
        "The row of the projector pixel that each camera pixel sees most.",
        "The column of that pixel.",
        "How much of a camera pixel's light comes from that pixel. Dark: the light comes from many "
        "places, by way of other surfaces.",
    )
    matches = maps.correspondence_maps(facts.correspondence)
    images = [image_of_map(*pair) for pair in zip(matches, captions, strict=True)]
    if maps.has_diagnostic(transport, "footprint"):
        caption = "How many projector pixels a camera pixel sees: many where it is out of focus."
        images.append(image_of_map(maps.footprint_map(transport), caption))
    share = percent(transport.background_share)
    background = photograph(
        transport.background.sum(axis=1).reshape(transport.camera_shape),
        f"Light of the background: {share} of all light",
        "Background",
        f"{share} of the light comes faintly from everywhere; on the scale of the white image.",
        white=maps.white_level(facts.white),
    )
    elements: list[Element] = [
        Text(
            "The projector pixel that each camera pixel sees most. `lightmatrix show SCENE.zarr "
            "correspondence -o map.npz` writes the numbers, to fractions of a pixel."
        ),
        Gallery(tuple(images)),
        Text(
            "A row of T shows on the projector where the light of a camera pixel comes from. A "
            "column of T shows in the camera where the light of a projector pixel goes. Faint "
            "light is brightened, so that it is visible beside the bright spot."
        ),
        Gallery((*_rows_and_columns(facts), background)),
    ]
    lead = "How light travels from the projector to the camera, directly and via other surfaces."
    return Section("matrix", "The light transport matrix", lead, tuple(elements))


def first_pictures(facts: Facts) -> Gallery:
    """The scene under white and from the projector: what T is, at a glance."""
    transport = facts.transport
    rows, cols, *_ = transport.camera_shape
    return Gallery(
        (
            photograph(
                facts.white,
                f"The scene under a white pattern, {rows} x {cols} pixels, computed from T",
                "White pattern",
                "The scene with every projector pixel lit, computed from T.",
            ),
            photograph(
                transport.dual_image(),
                "The scene seen from the projector, lit from the camera",
                "Dual image",
                "The scene as the projector would photograph it, lit from the camera.",
            ),
        )
    )


def _rows_and_columns(facts: Facts) -> tuple[Image, ...]:
    """The row of each example, and the column of the first one."""
    transport, images = facts.transport, list[Image]()
    for why, (row, col) in _example_pixels(facts).items():
        light = transport.row(row, col, *[0] * (len(transport.camera_shape) - 2))
        images.append(faint_image(light, f"Row of camera pixel {row}, {col}", why))
        if len(images) == 1:
            v, u = (int(k) for k in facts.correspondence.pixel[row, col])
            image = transport.column(v, u)
            title, caption = f"Column of projector pixel {v}, {u}", "The one that it sees most."
            images.append(faint_image(image.reshape(*image.shape[:2], -1).mean(2), title, caption))
    return tuple(images)


def _example_pixels(facts: Facts) -> dict[str, tuple[int, int]]:
    """A few camera pixels that differ from each other, each with its description."""
    matches = facts.correspondence
    white = facts.white if facts.white.ndim == 2 else facts.white.sum(axis=2)
    lit = matches.valid & (white > np.quantile(white, 0.5))
    lit = lit if lit.any() else matches.valid
    if not lit.any():
        return {}
    confidence = np.where(lit, matches.confidence, np.nan)
    middle = float(np.nanmedian(confidence))
    chosen = {
        "A typical bright camera pixel": np.nanargmin(np.abs(confidence - middle)),
        "The bright camera pixel with the most indirect light": np.nanargmin(confidence),
    }
    places = {why: np.unravel_index(int(flat), white.shape) for why, flat in chosen.items()}
    return {why: (int(row), int(col)) for why, (row, col) in places.items()}
