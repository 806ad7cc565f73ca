"""What this T can be used for: direct and global light, a compensated picture, the shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.evaluation.judgement import percent
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.report.elements import Element, Gallery, Section, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import (
    colour_image,
    image_of_map,
    pattern_image,
    photograph,
)
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.compensation import Compensation, compensator
from lightmatrix.uses.separation import separate
from lightmatrix.uses.shape_picture import depth_map, normal_colours
from lightmatrix.uses.triangulation import triangulate

# Larger cameras are left out. This many camera samples (512 x 512) take 11 s of one processor core,
# nearly all of it for the separation, in proportion to their number.
_MOST_SAMPLES = 1 << 18


def uses(facts: Facts) -> Section:
    """Direct and global light, a picture with and without compensation, depth and normals."""
    lead = "What this T is good for, under patterns that were never projected."
    transport = facts.transport
    if transport.shape[0] > _MOST_SAMPLES:
        elements: tuple[Element, ...] = (
            Text(
                "For a camera of this size, use `lightmatrix separate SCENE.zarr -o FOLDER`, "
                "`lightmatrix compensate SCENE.zarr WANTED.png -o PATTERN.png` and "
                "`lightmatrix triangulate SCENE.zarr --geometry RIG.json -o CLOUD.ply`."
            ),
        )
    else:
        elements = (
            *_separated(transport),
            *_compensated(transport),
            *_triangulated(transport, facts.geometry),
        )
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
    images = (
        photograph(
            direct, "Direct light under a white pattern", "Direct light", white=level, exact=True
        ),
        photograph(
            others,
            f"Global light under a white pattern, {percent(share)} of all light",
            "Global light",
            "On the same scale.",
            white=level,
            exact=True,
        ),
    )
    return Text(text), Gallery(images)


def _compensated(transport: LightTransport) -> tuple[Element, ...]:
    """A chart, what the camera sees without and with compensation, and the pattern for it."""
    chart = _chart(transport.camera_shape)
    shared = compensator(transport)
    try:
        found = shared.solve(chart.ravel())
    except InputError as error:
        return (Text(f"No picture can be compensated: {error.message}."),)
    plain = transport.relight(_placed(transport, chart))
    level = float(np.quantile(found.target, 0.99))
    reached = float(found.reachable.mean())
    text = (
        "The pattern that makes the scene look like a chart. Predicted PSNR where the projector's "
        f"light arrives: {found.psnr:.0f} dB; {percent(reached)} of the camera pixels are within "
        "5 % of wanted white. `lightmatrix compensate` takes a picture of your own."
    )
    return Text(text), Gallery(
        (
            photograph(found.target, "The wanted chart", "Wanted", white=level, exact=True),
            photograph(
                plain * _same_light(plain, found),
                "The chart projected onto the scene without compensation",
                "Without compensation",
                "The chart at its place, in the scene's own colours; as bright as the next image.",
                white=level,
                exact=True,
            ),
            photograph(
                found.predicted, "The compensated chart", "Compensated", white=level, exact=True
            ),
            pattern_image(found.patterns[0], "The pattern of the compensated chart", "Its pattern"),
        )
    )


def _triangulated(transport: LightTransport, geometry: RigGeometry | None) -> tuple[Element, ...]:
    """Maps of depth and normals, if the geometry of the rig is known."""
    if geometry is None:
        return (
            Text(
                "With the geometry of the rig, T gives the shape of the scene: "
                "`lightmatrix calibrate` measures it, `lightmatrix triangulate` uses it, and "
                "`--geometry` shows depth and normals here."
            ),
        )
    shape = triangulate(transport, geometry)
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
            image_of_map(depth_map(shape.depth, geometry.units), "Grey: no depth."),
            colour_image(
                normal_colours(shape.camera_normals),
                "Map over the camera of the normals of the surface as colours",
                "Normals",
                "Right, up and towards the camera are red, green and blue. Grey: no normal.",
            ),
        )
    )


def _chart(camera_shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Grey steps above a bright disc and a dark one, as the camera is to see them."""
    rows, cols = camera_shape[:2]
    down, right = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, cols), indexing="ij")
    steps = 0.25 + 0.75 * np.floor(right * 5.999) / 5
    image = np.where(down < 1 / 3, steps, 0.5)
    for centre, level in ((0.3, 1.0), (0.7, 0.25)):
        image[(down - 0.67) ** 2 + (right - centre) ** 2 < 0.17**2] = level
    channels = camera_shape[2:] or (1,)
    whole = np.repeat(image[..., None], channels[0], axis=2).reshape(camera_shape)
    return np.asarray(whole, np.float32)


def _placed(transport: LightTransport, chart: NDArray[np.float32]) -> NDArray[np.float32]:
    """The chart on the projector: each pixel shows the mean of what it is to light."""
    weight = transport.dual(np.ones(transport.camera_shape, np.float32))
    light = transport.dual(chart)
    placed = np.divide(light, weight, out=np.zeros_like(light), where=weight > 0)
    return np.clip(placed, 0, 1)


def _same_light(plain: NDArray[np.float32], found: Compensation) -> float:
    """The factor that makes an image as bright as the compensated one."""
    return float(found.predicted.sum() / max(float(plain.sum()), 1e-12))
