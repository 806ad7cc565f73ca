"""What no estimate can come from: refused before any work, with what to do about it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.frames import Frames, level_blocks
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.patterns.pattern_set import PatternSet

# Ends of the range of cameras whose levels are stored in 16 bits, low or high aligned.
_TOPS_IN_16_BITS = (1023, 4095, 16383, 65472, 65520, 65532)
# Of 8, 10, 12 and 14 bits.
_TOPS = (255, 1023, 4095, 16383)


def check_patterns(patterns: PatternSet) -> None:
    """Refuse patterns that tell nothing apart.

    A pattern that is constant (white, or fine stripes after binning) is no error.

    Raises
    ------
    InputError
        With one pattern, one projector pixel, no pattern that varies, or all alike.
    """
    if patterns.count == 1:
        raise InputError(
            "the capture has 1 frame only", hint="take at least 2 patterns, better 64 or more"
        )
    if patterns.pixels == 1:
        raise InputError(
            "the projector has 1 x 1 pixels", hint="use larger patterns, or bin them less"
        )
    first = patterns.rows(0, 1)[0]
    alike, flat = True, True
    for _, block in patterns.chunks():
        # After binning, equal pixels may differ in the last bit.
        flat = flat and bool((np.ptp(block, axis=1) < 1e-6).all())
        alike = alike and bool((np.abs(block - first) < 1e-6).all())
    if flat:
        raise InputError(
            "no pattern varies: each shows one grey value all over",
            hint="use other patterns, or bin the projector less",
        )
    if alike:
        raise InputError("all patterns are the same", hint="use patterns that differ")


def check_light(tiles: Iterable[tuple[int, Samples]], valid: int, decoder: Decoder) -> None:
    """Refuse frames that are dark, clipped or masked throughout.

    Parameters
    ----------
    tiles : iterable of (int, Samples)
        All samples, tile by tile.
    valid : int
        Number of camera samples that count.
    decoder : Decoder
        How they were decoded.

    Raises
    ------
    InputError
        If the samples hold no light, or hardly one is below the clip level.
    """
    if valid == 0:
        raise InputError(
            "all camera pixels are masked", hint="correct the mask, or take a darker black frame"
        )
    brightest, clipped, total = 0.0, 0, 0
    for _, tile in tiles:
        level = np.broadcast_to(tile.clip_level, tile.values.shape)
        brightest = max(brightest, float((tile.values / level).max(initial=0)))
        clipped += int(tile.clipped.sum())
        total = valid * tile.values.shape[1]
    # Two levels above black are no signal.
    span = np.min(np.asarray(decoder.clip) - np.asarray(decoder.black_level))
    if brightest <= (2.5 / span if decoder.full_scale > 1 else 1e-6):
        raise InputError(
            "all images are dark: no sample rises above the black level",
            hint="expose longer, and check the black frame and black level",
        )
    if clipped > 0.99 * total:
        raise InputError(
            f"{100 * clipped / total:.1f} % of the samples are clipped",
            hint="expose so that most samples stay below the clip level; 1 to 20 % may clip",
        )


def check_depth(frames: Frames, decoder: Decoder) -> None:
    """Refuse 16-bit files that hold fewer bits, while their full range was assumed.

    A camera of 12 bits clips at 4095: with 65535 in its place all samples are below 1/16, none is
    clipped, and an estimate finds nothing without a sign that it is wrong.

    Raises
    ------
    InputError
        Naming the clip level that is probably meant.
    """
    if not decoder.clip_assumed or frames.dtype != np.uint16:
        return
    top = 0
    for block in level_blocks(frames):
        top = max(top, int(block.max()))
        if top > _TOPS[-1]:
            return
    likely = next(level for level in _TOPS if level >= top)
    raise InputError(
        f"the images have 16 bits, but no level above {top}: a camera that clips at {likely}?",
        hint=f'say --clip {likely}, or "clip" in capture.json; --clip 65535 if they are just dark',
    )


def warn_of_hidden_clipping(blocks: Iterable[NDArray[np.integer]], decoder: Decoder) -> None:
    """Warn if 16-bit levels, all of them block by block, end where many cameras end.

    That is below the clip level.
    """
    top, many = 0, 0
    for block in blocks:
        highest = int(block.max(initial=0))
        if highest > top:
            top, many = highest, 0
        # Asked of few blocks, since most levels are no camera's last one.
        if highest == top and top in _TOPS_IN_16_BITS:
            many += int((block == top).sum())
    clip = float(np.min(decoder.clip))
    if top < clip and many > 3:
        warnings.warn(
            f"{many} samples are exactly {top}, the brightest level, at which many cameras clip, "
            f"but the clip level is {clip:g}: should it be {top}?",
            LightMatrixWarning,
            stacklevel=2,
        )


def check_per_frame(decoder: Decoder, count: int) -> None:
    """Refuse lists of exposures or levels that do not have one number a frame.

    Raises
    ------
    InputError
        Naming the list.
    """
    for name in ("clip", "black_level", "exposure"):
        value = np.asarray(getattr(decoder, name))
        if value.ndim and value.shape != (count,):
            raise InputError(
                f"{name} has {value.size} values for {count} frames",
                hint="give one number, or one for each frame",
            )
