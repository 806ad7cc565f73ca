"""What no estimate can come from: refused before any work, with what to do about it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.decoding import check_depth
from lightmatrix.diagnosis.check import check_survey
from lightmatrix.diagnosis.finding import refuse_disorder
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.patterns.pattern_set import PatternSet

# Ends of the range of cameras whose levels are stored in 16 bits, low or high aligned.
_TOPS_IN_16_BITS = (1023, 4095, 16383, 65472, 65520, 65532)


def refuse_unusable(capture: Capture) -> None:
    """Refuse a capture that no estimate can come from, whatever the order of its frames.

    Raises
    ------
    InputError
        With one frame only, a projector of one pixel, no pattern that varies, nothing but dark or
        clipped samples, all pixels masked, or 16-bit files of fewer bits without a stated clip
        level.
    """
    _check_patterns(capture.patterns)
    check_depth(capture.frames, capture.decoder)
    _check_light(capture.tiles(), int(capture.valid.sum()), capture.decoder)
    if capture.frames.dtype == np.uint16 and capture.bin_camera == (1, 1):
        _warn_of_hidden_clipping(capture.reader.level_blocks(), capture.decoder)


def refuse_unordered(capture: Capture) -> None:
    """Refuse a capture whose frames do not follow its patterns (swapped, missing, late).

    Raises
    ------
    InputError
        Naming the frames, as `lightmatrix check` does.
    """
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    names = [capture.frames.name(k) for k in range(capture.count)]
    refuse_disorder(check_survey(survey, names, order_only=True))


def _check_patterns(patterns: PatternSet) -> None:
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


def _check_light(tiles: Iterable[tuple[int, Samples]], valid: int, decoder: Decoder) -> None:
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


def _warn_of_hidden_clipping(blocks: Iterable[NDArray[np.integer]], decoder: Decoder) -> None:
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
