"""Capture folders, and two plain folders of images: reading and writing.

Their settings, and the files that these name, become the decoder and the mask of a capture.

A capture folder holds::

    patterns/      one image for each pattern, and patterns.json if they can be remade
    images/        one image for each frame, in the same natural order
    capture.json   exposure, clip and black level, response, ... (all optional)

Either folder may be replaced by one file of all its images, such as images.tif; images/ also by
images.zarr, which `pack` writes.
"""

import json
import math
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC, Response, range_end
from lightmatrix.capture.clip_level import pile_of_frames
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.frames import CaptureParts, Frames, PixelFrames, level_blocks
from lightmatrix.capture.packed import PACKED, open_frames
from lightmatrix.capture.samples import Samples
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import (
    FORMAT,
    NAME,
    VERSION,
    Description,
    ReadSettings,
    read_description,
)
from lightmatrix.errors import InputError, warn
from lightmatrix.files.colours import instead_of
from lightmatrix.files.images import JPEG, READABLE, fill_image, is_grey, likely_white, read_image
from lightmatrix.files.kinds import CAPTURE, read_object
from lightmatrix.files.reading import errors_naming
from lightmatrix.files.stacks import ImageStack, is_stack, nonlinear_tag
from lightmatrix.files.writing import atomic_folder
from lightmatrix.paths import as_path
from lightmatrix.patterns.bits import with_white
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.folder import fill_pattern_folder, read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.reprs import jsonable


def read_capture(
    folder: str | Path, *, allow_outside: bool = False, counted: bool = True
) -> CaptureParts:
    """Read a capture folder, with outside files only if `allow_outside`."""
    place = as_path(folder)
    if not place.is_dir():
        problem = "is a file, not a capture folder" if place.exists() else "no such folder"
        raise InputError(f"{place}: {problem}", hint="give a folder with patterns/ and images/")
    pattern_images, photographs = _find_images(place, "patterns"), _find_images(place, "images")
    file = place / NAME
    # A dangling link is an error, not a folder without a description.
    described = os.path.lexists(file)
    if described:
        description = read_description(file, allow_outside=allow_outside)
    else:
        for entry in sorted(place.iterdir()):
            if entry.name.casefold() == NAME:
                hint = f"rename it to {NAME}"
                raise InputError(f"{entry}: is not read under this name", hint=hint)
        description = Description()
    settings = _with_files_beside(place, description, described)
    shown = read_patterns(pattern_images)
    _check_projected(shown, file)
    patterns, curve = _as_light(shown, settings)
    stack: Frames
    if photographs.name == PACKED:
        stack = open_frames(photographs)
    else:
        stack = ImageStack.open(photographs, mosaic=settings.mosaic)
    if counted:
        _check_counts(patterns, stack, photographs)
    for key, stated, shape, what in (
        ("projector_shape", description.projector_shape, patterns.shape, "patterns"),
        ("camera_shape", description.camera_shape, stack.shape, "images"),
    ):
        if stated is not None and stated != shape:
            raise InputError(
                f"{file}: {key} is {list(stated)}, but the {what} have {list(shape)}",
                hint="correct capture.json, or restore the folder",
            )
    with errors_naming(file):
        decoder = make_decoder(stack, settings)
        if counted:
            decoder.check_count(stack.count)
    mask = read_mask(settings.mask, stack.shape)
    unknown = settings.projector_response == AUTOMATIC
    provenance = {**description.provenance, **curve}
    return CaptureParts(patterns, stack, decoder, mask, provenance, unknown, description.projectors)


def read_folders(
    patterns: str | Path | PatternSet,
    images: str | Path,
    settings: ReadSettings,
    *,
    counted: bool = True,
) -> CaptureParts:
    """Read two folders of images, or stacks, as many of each if `counted`."""
    projected = patterns if isinstance(patterns, PatternSet) else read_patterns(patterns)
    _check_projected(projected, Path(images).parent / NAME)
    projected, curve = _as_light(projected, settings)
    stack = ImageStack.open(images, mosaic=settings.mosaic)
    if counted:
        _check_counts(projected, stack, Path(images))
    if settings.white is not None:
        if isinstance(projected, ColourPatterns):
            red, green, blue = map(with_white, projected.primaries)
            projected = ColourPatterns(red, green, blue)
        else:
            projected = with_white(projected)
        stack = replace(stack, paths=(*stack.paths, Path(settings.white)))
    decoder = make_decoder(stack, settings)
    unknown = settings.projector_response == AUTOMATIC
    mask = read_mask(settings.mask, stack.shape)
    return CaptureParts(projected, stack, decoder, mask, curve, projector_unknown=unknown)


def _check_projected(patterns: PatternSet, file: Path) -> None:
    """Refuse patterns that the description beside the photographs does not list."""
    listed = (read_object(file) or {}).get("patterns")
    if not isinstance(listed, list) or set(patterns.digests) <= set(map(str, listed)):
        return
    other = [k for k, digest in enumerate(patterns.digests) if digest not in listed]
    raise InputError(
        f"{file}: {len(other)} of the {patterns.count} patterns, the first of them pattern "
        f"{other[0]} (counted from 0), are not those that were projected",
        hint=f'give the patterns of this capture; or remove "patterns" from {file} to use others',
    )


def write_capture(
    folder: str | Path,
    patterns: PatternSet,
    frames: NDArray[Any] | Iterable[NDArray[Any] | Path],
    *,
    sensor: Sensor,
    camera_shape: tuple[int, ...] | None = None,
    black: NDArray[Any] | None = None,
    black_exposure: float | None = None,
    response: str = "linear",
    provenance: Mapping[str, Any] | None = None,
    projectors: Sequence[tuple[int, int]] = (),
    write_extras: Callable[[Path], None] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a capture folder, whole or not at all.

    `frames` are K raw images (rows, cols[, channels]) or files of them, which are linked where
    possible; they become PNG, or npy if float32. `black` is at `black_exposure`; the mean of
    several is float32. `write_extras` writes further files into the folder, such as the curve that
    `response` names.
    """
    suffix = ".png" if sensor.bits else ".npy"
    digits = max(4, len(str(patterns.count - 1)))
    with atomic_folder(folder, CAPTURE, overwrite=overwrite) as part:
        (part / "images").mkdir()
        shape, count = camera_shape, 0
        for count, frame in enumerate(frames, 1):
            image = part / "images" / f"image_{count - 1:0{digits}d}{suffix}"
            if isinstance(frame, Path):
                image = image.with_suffix(frame.suffix)
                try:
                    os.link(frame, image)
                except OSError:
                    shutil.copyfile(frame, image)
                continue
            shape = shape or frame.shape
            if frame.shape != shape:
                raise InputError(
                    f"frame {count - 1} has shape {frame.shape}, expected {shape}",
                    hint="give frames of one shape",
                )
            fill_image(image, frame)
        if count != patterns.count:
            hint = "give one a pattern"
            raise InputError(f"{count} frames for {patterns.count} patterns", hint=hint)
        decoder = sensor.decoder()
        if black is not None:
            decoder = replace(decoder, black_frame=black, black_exposure=black_exposure)
        about: dict[str, Any] = {"provenance": provenance, "projectors": projectors}
        write_description(part, patterns, shape or (), decoder, response=response, **about)
        if write_extras is not None:
            write_extras(part)


def write_description(
    part: Path,
    patterns: PatternSet,
    shape: tuple[int, ...],
    decoder: Decoder,
    *,
    response: str | None = None,
    mask: NDArray[np.bool_] | None = None,
    provenance: Mapping[str, Any] | None = None,
    projectors: Sequence[tuple[int, int]] = (),
    projector_unknown: bool = False,
) -> None:
    """Write all of a capture folder but its images: patterns, capture.json, the files it names.

    `shape` is that of a frame. The file of a `response` is written by others; None: that of the
    decoder, whose curve becomes a file if it has no other name.
    """
    images = patterns.images
    if isinstance(patterns, ColourPatterns):
        images = patterns.colour_images
    # The images of a pattern folder have 8 bits.
    in_8_bits = patterns.kind != PatternSet.kind or all(
        np.array_equal(patterns.greys(k, k + 1)[0] / np.float32(255), patterns.images(k, k + 1)[0])
        for k in range(patterns.count)
    )
    if not in_8_bits:
        np.save(part / "patterns.npy", images())
    else:
        (part / "patterns").mkdir()
        fill_pattern_folder(part / "patterns", patterns)
    content: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "projector_shape": list(patterns.shape),
        "camera_shape": list(shape), "patterns": patterns.digests, "exposure": decoder.exposure,
        "black_level": decoder.black_level, "full_scale": decoder.full_scale,
        "response": response or decoder.response.name, "provenance": dict(provenance or {}),
    }  # fmt: skip
    if not decoder.clip_assumed:
        content["clip"] = decoder.clip
    if decoder.black_frame is not None:
        black = np.asarray(decoder.black_frame).reshape(shape)
        name = "black.png" if black.dtype.kind == "u" else "black.npy"
        fill_image(part / name, black)
        content["black"] = {"file": name}
        if decoder.black_exposure is not None:
            content["black"]["exposure"] = decoder.black_exposure
    if mask is not None:
        fill_image(part / "mask.npy", mask.astype(np.uint8))
        content["mask"] = "mask.npy"
    if response is None and (points := decoder.response.nameless) is not None:
        np.save(part / "response.npy", points)
        content["response"] = "curve:response.npy"
    if projectors:
        content["projectors"] = [list(size) for size in projectors]
    if projector_unknown:
        content["projector_response"] = AUTOMATIC
    (part / NAME).write_text(json.dumps(content, indent=2, default=jsonable) + "\n")


def _find_images(place: Path, name: str) -> Path:
    """The folder `name` of a capture, or the one file of all its images, such as images.tif."""
    folder = place / name
    sources = [folder] if folder.is_dir() else []
    sources += [
        entry
        for entry in sorted(place.iterdir())
        if (entry.stem == name and is_stack(entry) and not entry.is_dir())
        or (name == "images" and entry.name == PACKED)
    ]
    if not sources:
        hint = "give a folder with patterns/ and images/ (or a stack of each, such as images.tif), "
        hint = instead_of(place, f"{hint}or patterns and images by themselves")
        raise InputError(f"{place}: has no folder {name}/", hint=hint)
    if len(sources) > 1:
        hint = "keep the one that is meant"
        raise InputError(f"{place}: holds {sources[0].name} and {sources[1].name}", hint=hint)
    return sources[0]


def _with_files_beside(place: Path, description: Description, described: bool) -> ReadSettings:
    """The settings with a black frame and a mask that lie in a folder without capture.json."""
    settings = description.settings
    for key, what in (("black", "the black frame"), ("mask", "the mask")):
        if described and key not in description.absent:
            continue
        files = [
            entry
            for entry in sorted(place.iterdir())
            if entry.stem.lower() == key and entry.suffix.lower() in READABLE
        ]
        if not files:
            continue
        if described:
            message = f"{files[0]}: is not used, since {NAME} does not name it"
            message += f'; add "{key}" to it, or "{key}": null to leave it out'
        elif len(files) > 1:
            hint = f"keep the one that is {what}"
            raise InputError(f"{place}: holds {files[0].name} and {files[1].name}", hint=hint)
        else:
            message = f"{files[0]}: is used as {what}, since there is no {NAME}"
            if key == "black":
                settings = replace(settings, black=files[0])
            else:
                settings = replace(settings, mask=files[0])
        warn(message)
    return settings


def _check_counts(patterns: PatternSet, stack: Frames, images: Path) -> None:
    if patterns.count != stack.count:
        raise InputError(
            f"{patterns.count} patterns, but {stack.count} images in {images}",
            hint="give one image for each pattern, both in natural order; is one missing?",
        )


def _as_light(patterns: PatternSet, settings: ReadSettings) -> tuple[PatternSet, dict[str, Any]]:
    """The light of patterns that the projector was sent as grey values, if their light is known.

    Also the response for the description of the capture.
    """
    response = settings.projector_response
    if response is None or response == AUTOMATIC:
        return patterns, {}
    if not isinstance(response, ProjectorResponse):
        response = ProjectorResponse.load(response)
    return response.light_of_patterns(patterns), response.as_provenance


def make_decoder(stack: Frames, settings: ReadSettings) -> Decoder:
    """The decoder of a stack, with its black frame and its range of levels.

    The black level is 0 unless it is stated. It is not taken from the black frame, whose room light
    must not change the unit of the samples.
    """
    response = settings.response
    if not isinstance(response, Response):
        first = stack.paths[0] if isinstance(stack, ImageStack) else None
        if response is None and first is not None and (tag := nonlinear_tag(first)) is not None:
            warn(
                f"{first}: {tag}, so probably not linear, but no response is given; "
                "give one (srgb, gamma:2.2, ...), or linear if it is"
            )
        response = Response() if response is None else Response.parse(str(response))
    measured, full_scale = response.full_scale, settings.full_scale
    stated = None if isinstance(settings.clip, str) else settings.clip
    top = range_end(stack.dtype, stated)
    if measured is not None and measured > top:
        # Float images may hold such levels, or levels up to 1, which all would be dark.
        floats = f"; give clip={measured:g} if their levels go up to it"
        raise InputError(
            f"a response of levels up to {measured:g} for images of {stack.dtype}",
            hint="measure it with images of that kind" + floats * (stack.dtype.kind == "f"),
        )
    if full_scale is not None and stack.dtype.kind == "u" and full_scale > top:
        hint = f"use a raw level of at most {top:g}"
        raise InputError(f"a full scale of {full_scale:g} for images of {stack.dtype}", hint=hint)
    clip, assumed = settings.clip, settings.clip is None and measured is None
    if isinstance(clip, str):
        pile = pile_of_frames(stack)
        if pile is not None:
            warn(f"clip: {pile}, where the camera seems to clip")
        clip, assumed = None if pile is None else float(pile.shown), pile is None
    full_scale = full_scale or measured or range_end(stack.dtype, clip)
    clip = full_scale if clip is None else clip
    return Decoder(
        clip,
        full_scale,
        0.0 if settings.black_level is None else settings.black_level,
        response.of_full_scale(full_scale),
        settings.exposure,
        _read_black(stack, settings, clip),
        settings.black_exposure,
        # A measured response ends at the clip level of its camera.
        assumed,
    )


def _read_black(
    stack: Frames, settings: ReadSettings, clip: float | NDArray[Any]
) -> NDArray[Any] | None:
    """Raw levels of the black frame, (M,); None where there is none."""
    file = settings.black
    if file is None:
        return None
    assert isinstance(file, (str, Path))
    image = read_image(file, mosaic=settings.mosaic)
    if image.ndim == 3 and len(stack.shape) == 2 and is_grey(image):
        image = image[..., 0]
    if image.shape != stack.shape:
        raise InputError(
            f"{file}: the black frame has shape {image.shape}, the images {stack.shape}",
            hint="take the black frame with the same camera settings",
        )
    # The mean of several black frames is kept as float, in levels of the frames.
    if image.dtype != stack.dtype and image.dtype.kind != "f":
        raise InputError(
            f"{file}: the black frame is {image.dtype}, the images {stack.dtype}",
            hint="save it with the bit depth of the images",
        )
    if (dark := float(np.median(image))) >= np.min(clip):
        hint = "take it with the projector showing black"
        raise InputError(f"{file}: the black frame is clipped", hint=hint)
    level = -np.inf if settings.black_level is None else np.min(settings.black_level)
    # Noise reaches somewhat below.
    if dark < level - 0.01 * np.max(clip):
        hint = f"leave the black level out, or give one of at most {dark:g}"
        raise InputError(f"{file}: is darker than the black level of {level:g}", hint=hint)
    exposure = settings.black_exposure
    differs = exposure is not None and bool((np.asarray(settings.exposure) != exposure).any())
    if settings.black_level is None and differs:
        raise InputError(
            f"{file}: its exposure differs from that of the frames, but no black level is given, "
            "which does not scale with the exposure",
            hint='give "black_level" in capture.json, 0 for a camera without pedestal',
        )
    return image.ravel()


def check_depth(frames: Frames, decoder: Decoder) -> None:
    """Refuse swapped bytes, negative levels, and 16-bit files of fewer bits without a clip level.

    A camera of 12 bits clips at 4095. With 65535 in its place no sample would count as clipped: the
    estimate would be wrong without any sign of it.
    """
    if frames.dtype == np.uint8:
        return
    if isinstance(frames, PixelFrames):
        # To read one of these frames is to read all.
        half = math.prod(frames.shape) // 2
        middle = frames.levels(half, min(half + 4096, math.prod(frames.shape)))
    else:
        middle = frames.read(frames.count // 2)
    dark = float(np.median(middle))
    # Noise around a dark frame that was subtracted is far smaller.
    if dark < -0.05 * np.min(decoder.clip):
        hint = "scale the images so that 0 is no light"
        raise InputError(f"half of the levels that were looked at are below {dark:g}", hint=hint)
    # One frame may lack some bits by chance, and a few levels without noise all may.
    if len(np.unique(middle)) > 16 and _swapped([middle]) and _swapped(level_blocks(frames)):
        raise InputError(
            "the two bytes of each level are swapped: the bits that all levels use have a gap",
            hint="write the images in the byte order that their format or header states",
        )
    if not decoder.clip_assumed:
        return
    if frames.dtype.kind == "f":
        highest = max(float(block.max()) for block in level_blocks(frames))
        # Noise and interpolated colours reach somewhat above 1. Raw levels, such as 0 to 255, that
        # were saved as float reach far above 2, and nearly all of them would clip at 1.
        if highest > 2:
            pile = pile_of_frames(frames)
            white = "255" if pile is None else f"{pile.shown}: {pile}"
            raise InputError(
                f"the images are float with levels up to {highest:g}, but float images clip at 1",
                hint=f'give their level of white, such as clip={white}, or "clip" in capture.json',
            )
    if frames.dtype != np.uint16:
        return
    top = _highest_level(frames)
    if (likely := likely_white(frames.dtype, top)) is None:
        return
    pile = pile_of_frames(frames)
    which = f"that clips at {likely}?" if pile is None else f"that clips? {pile}"
    hint = f"give clip={likely if pile is None else pile.shown}"
    raise InputError(
        f"the images have 16 bits, but no level above {top}: a camera {which}",
        hint=f'{hint}, or "clip" in capture.json; clip=65535 if they are just dark',
    )


def _highest_level(frames: Frames) -> int:
    """The highest level of all pixels but hot ones, which are never darker than half of it."""
    lowest, highest = [], []
    for block in level_blocks(frames):
        if isinstance(frames, PixelFrames):
            lowest.append(block.min(axis=1))
            highest.append(block.max(axis=1))
        else:
            lowest = [np.minimum(block, *lowest) if lowest else block]
            highest = [np.maximum(block, *highest) if highest else block]
        # More than one pixel in a thousand is no defect.
        if likely_white(frames.dtype, int(np.quantile(highest[-1], 0.999))) is None:
            break
    low, high = (np.concatenate([block.ravel() for block in part]) for part in (lowest, highest))
    stuck = low > high.max() // 2
    return int(high.max() if stuck.mean() > 1e-3 else high[~stuck].max())


def _swapped(levels: Iterable[NDArray[Any]]) -> bool:
    """Whether the bits that levels of 16 bits use have a gap, and none with their bytes swapped.

    The bits of a camera are neighbours: those of 12 bits are 0x0fff or 0xfff0 in a file.
    """
    used = 0
    for block in levels:
        used |= int(np.bitwise_or.reduce(block, axis=None)) if block.dtype == np.uint16 else 0
    gaps = ["0" in f"{bits:b}".strip("0") for bits in (used, used >> 8 | (used & 255) << 8)]
    return gaps == [True, False]


def read_mask(mask: str | Path | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    """The camera samples where a mask image is not 0, like a frame; None without a mask."""
    if mask is None:
        return None
    image = read_image(mask)
    if image.ndim == 2 and len(shape) == 3 and image.shape == shape[:2]:
        image = np.repeat(image[..., None], shape[2], axis=2)
    if image.shape != shape:
        hint = "make the mask as large as the images"
        raise InputError(f"{mask}: the mask has shape {image.shape}, the images {shape}", hint=hint)
    # Compression changes 0 beside brighter pixels, which would then count.
    if Path(mask).suffix.lower() in JPEG and np.isin(image, (0, 255), invert=True).any():
        raise InputError(
            f"{mask}: is a JPEG, whose compression turns 0 into other values",
            hint="save the mask as PNG, with 0 where camera pixels are left out",
        )
    return np.asarray(image > 0)


def read_white_frame(path: str | Path, settings: ReadSettings) -> Samples:
    """The M samples of a photograph that do not clip without light, (M, 1), at exposure 1."""
    file = as_path(path)
    if not file.exists():
        hint = "give a photograph of a white pattern, a scene, or a T.npz"
        raise InputError(f"{file}: no such file", hint=hint)
    stack = ImageStack.open([file])
    decoder = make_decoder(stack, replace(settings, response=settings.response or Response()))
    check_depth(stack, decoder)
    decoded = decoder.decode(stack.read(0).reshape(-1, 1))
    keep = slice(None) if decoder.hot is None else ~decoder.hot
    level = decoded.clip_level if decoded.clip_level.ndim == 1 else decoded.clip_level[keep]
    values = np.asarray(decoded.values[keep])
    bright = float(np.quantile(values, 0.99)) if values.size else 0.0
    # So little is black level and noise rather than light.
    if bright < 0.02:
        raise InputError(
            "the white frame is dark: its bright pixels are at "
            f"{100 * max(bright, 0):.1f} % of the clip level",
            hint="photograph the white pattern with a longer exposure; if the pixels show the "
            "black level, state it, such as black=16",
        )
    return Samples(values, np.asarray(decoded.clipped[keep]), level)
