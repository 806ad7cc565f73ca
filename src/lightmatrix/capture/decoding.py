"""Makes decoder, mask and white frame of a capture from its settings and the files they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response, range_end
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.frames import Frames, level_blocks
from lightmatrix.capture.samples import Samples
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError, warn
from lightmatrix.files.images import HIGHEST_LEVELS, is_grey, read_image
from lightmatrix.files.stacks import ImageStack, nonlinear_tag
from lightmatrix.patterns.pattern_set import PatternSet

# Endings of JPEG files.
JPEG = (".jpg", ".jpeg")


@dataclass(frozen=True, eq=False)
class CaptureParts:
    """The parts of a capture as read from disk; patterns and frames may still differ in number."""

    patterns: PatternSet
    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    # Whether the patterns are grey values whose light is to be found in the frames.
    projector_unknown: bool = False


def make_decoder(stack: ImageStack, settings: ReadSettings) -> Decoder:
    """The decoder of a stack, with its black frame and its range of levels.

    The black level is 0 unless it is stated. It is not taken from the black frame, whose room light
    must not change the unit of the samples.
    """
    top = range_end(stack.dtype)
    response = _stated_response(settings.response, stack)
    measured, full_scale = response.full_scale, settings.full_scale
    if measured is not None and measured > top:
        raise InputError(
            f"a response of levels up to {measured:g} for images of {stack.dtype}",
            hint="measure it with images of that kind",
        )
    if full_scale is None:
        full_scale = measured or top
    elif stack.dtype.kind == "u" and full_scale > top:
        raise InputError(
            f"a full scale of {full_scale:g} for images of {stack.dtype}",
            hint=f"use a raw level of at most {top:g}",
        )
    clip = full_scale if settings.clip is None else settings.clip
    return Decoder(
        clip,
        full_scale,
        0.0 if settings.black_level is None else settings.black_level,
        response.of_full_scale(full_scale),
        settings.exposure,
        _read_black(stack, settings, clip),
        settings.black_exposure,
        # A measured response ends at the clip level of its camera.
        settings.clip is None and measured is None,
    )


def _read_black(
    stack: ImageStack, settings: ReadSettings, clip: float | NDArray[Any]
) -> NDArray[Any] | None:
    """Raw levels of the black frame, (M,); None where there is none."""
    file = settings.black
    if file is None:
        return None
    assert isinstance(file, (str, Path))
    image = read_image(file, mosaic=stack.mosaic)
    if image.ndim == 3 and stack.grey and is_grey(image):
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
    if float(np.median(image)) >= np.min(clip):
        raise InputError(
            f"{file}: the black frame is clipped", hint="take it with the projector showing black"
        )
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
    """Refuse 16-bit files that hold fewer bits if no clip level is stated.

    A camera of 12 bits clips at 4095. With 65535 in its place no sample would count as clipped: the
    estimate would be wrong without any sign of it.
    """
    if not decoder.clip_assumed:
        return
    if frames.dtype.kind == "f":
        _check_float(frames)
    if frames.dtype != np.uint16:
        return
    top = 0
    for block in level_blocks(frames):
        top = max(top, int(block.max()))
        if top > HIGHEST_LEVELS[-1]:
            return
    likely = next(level for level in HIGHEST_LEVELS if level >= top)
    raise InputError(
        f"the images have 16 bits, but no level above {top}: a camera that clips at {likely}?",
        hint=f'give --clip {likely}, or "clip" in capture.json; --clip 65535 if they are just dark',
    )


def _check_float(frames: Frames) -> None:
    """Refuse raw levels, such as 0 to 255, that were saved as float: nearly all would clip at 1."""
    top = max(float(block.max()) for block in level_blocks(frames))
    # Noise and interpolated colours reach somewhat above 1; levels of 8 bits reach far above 2.
    if top > 2:
        raise InputError(
            f"the images are float with levels up to {top:g}, but float images clip at 1",
            hint='give --clip LEVEL, or "clip" in capture.json, in the levels of the images',
        )


def read_mask(mask: str | Path | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    """The camera samples where a mask image is not 0, like a frame; None without a mask."""
    if mask is None:
        return None
    image = read_image(mask)
    if image.ndim == 2 and len(shape) == 3 and image.shape == shape[:2]:
        image = np.repeat(image[..., None], shape[2], axis=2)
    if image.shape != shape:
        raise InputError(
            f"{mask}: the mask has shape {image.shape}, the images {shape}",
            hint="make the mask as large as the images",
        )
    # Compression changes 0 beside brighter pixels, which would then count.
    if Path(mask).suffix.lower() in JPEG and np.isin(image, (0, 255), invert=True).any():
        raise InputError(
            f"{mask}: is a JPEG, whose compression turns 0 into other values",
            hint="save the mask as PNG, with 0 where camera pixels are left out",
        )
    return np.asarray(image > 0)


def _stated_response(response: Response | str | None, stack: ImageStack) -> Response:
    """The stated response, or the linear one, with a warning if the files are tagged otherwise."""
    if isinstance(response, Response):
        return response
    if response is not None:
        return Response.parse(str(response))
    tag = nonlinear_tag(stack.paths[0])
    if tag is not None:
        warn(
            f"{stack.paths[0]}: {tag}, so probably not linear, but no response is given; "
            "give one (srgb, gamma:2.2, ...), or linear if it is",
        )
    return Response()


def read_white_frame(path: str | Path, settings: ReadSettings) -> Samples:
    """The M samples of a photograph that do not clip without light, (M, 1), at exposure 1."""
    file = Path(path)
    if not file.exists() or file.is_dir():
        problem = "is a folder" if file.is_dir() else "no such file"
        raise InputError(
            f"{file}: {problem}", hint="give a photograph of a white pattern, a scene, or a T.npz"
        )
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
            "black level, give --black",
        )
    return Samples(values, np.asarray(decoded.clipped[keep]), level)
