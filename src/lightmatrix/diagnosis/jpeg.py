"""Whether photographs went through lossy compression, told from their pixels.

JPEG rounds the cosine transform of each block of 8 x 8 pixels to multiples of a step, one for each
of the 64 frequencies. What is rounded once more by the same steps hardly changes, even where it was
cut off at the ends of the range: compressed again at the same quality, photographs come out nearly
as they went in, and at no other quality. Steps of a camera's own show as combs on which the
coefficients lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.survey import BLOCK, Survey

# Steps that are looked for. Rounding to whole levels hides finer ones.
_STEPS = np.arange(3, 128)
# Coefficients that a comb is told from, at least, and how closely they must follow it (the mean
# cosine of their distance to the next tooth, 0 by chance).
_FEWEST, _FOLLOWED = 40, 0.5
# In so many of the frequencies that have enough coefficients.
_SHARE, _FREQUENCIES = 0.5, 6
_BLOCKS = 3000
_FRAMES = 8
# Steps for luminance at quality 50 (ITU T.81, Annex K), as libjpeg scales them.
_TABLE = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ]
)
# From 96 on steps are 1 and photographs as good as lossless.
_QUALITIES = range(20, 96)
# The change at a quality must lie this much below that at the qualities so far around it.
_DIP, _REACH = 0.6, 5


def check_jpeg(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Whether the raw levels were rounded as JPEG does.

    Parameters
    ----------
    survey : Survey
        Only frames of 8 bits, and of 8 x 8 pixels or more, are looked at.
    names : sequence of str
        What the frames are called.
    """
    if survey.raw.dtype != np.uint8 or min(survey.grid[1:3]) < BLOCK:
        return []
    frames = np.unique(np.linspace(0, survey.count - 1, _FRAMES).astype(int))
    images = np.moveaxis(survey.raw[:, frames].reshape(*survey.grid, len(frames)), -1, 0)
    blocks = _blocks(_luminance(images))
    quality = likely_quality(blocks)
    step = None if quality else quantisation(blocks)
    if not quality and step is None:
        return []
    how = f"of quality {quality}" if quality else f"with steps of about {step:.0f} levels"
    hidden = not names[0].lower().endswith((".jpg", ".jpeg"))
    return [
        Finding(
            "jpeg",
            (),
            f"the photographs went through JPEG {how}"
            + (", whatever their files are now" if hidden else ""),
            "save raw or lossless files (PNG, TIFF) in the camera's own software; if there is only "
            "JPEG, take its best quality, and say --response srgb if it is not linear",
        )
    ]


def likely_quality(blocks: NDArray[np.float64]) -> int | None:
    """The quality at which blocks were compressed with the usual steps; None if at none.

    Parameters
    ----------
    blocks : (n, 8, 8) float64
        Blocks of levels, from 0 to 255.
    """
    if len(blocks) < _FEWEST:
        return None
    coefficients = dctn(blocks - 128, axes=(1, 2), norm="ortho")
    change = []
    for quality in _QUALITIES:
        scale = 5000 // quality if quality < 50 else 200 - 2 * quality
        steps = np.clip((_TABLE * scale + 50) // 100, 1, 255)
        again = idctn(steps * np.rint(coefficients / steps), axes=(1, 2), norm="ortho") + 128
        change.append(float(np.mean((np.rint(again).clip(0, 255) - blocks) ** 2)))
    # Photographs that were never compressed change less and less as the quality rises.
    for k in range(_REACH, len(change) - _REACH):
        around = min(change[k - _REACH], change[k + _REACH])
        near = change[k - _REACH : k + _REACH + 1]
        if change[k] == min(near) and change[k] < _DIP * around:
            return _QUALITIES[k]
    return None


def quantisation(blocks: NDArray[np.float64]) -> float | None:
    """The usual step of the combs that blocks lie on; None if they lie on none.

    Parameters
    ----------
    blocks : (n, 8, 8) float64
        Blocks of levels, from 0 to 255; those that reach an end of the range are passed over.
    """
    blocks = blocks[(blocks.min(axis=(1, 2)) > 0) & (blocks.max(axis=(1, 2)) < 255)]
    if not len(blocks):
        return None
    coefficients = dctn(blocks, axes=(1, 2), norm="ortho").reshape(-1, BLOCK * BLOCK)
    looked, combs = 0, []
    # The mean of a block, the first, is left out: flat areas put it on a comb by chance.
    for values in coefficients.T[1:]:
        best = 0.0
        enough = False
        for step in _STEPS:
            # A comb of only one tooth, at zero, is a smooth image.
            beyond = values[np.abs(values) > step / 2]
            if len(beyond) < _FEWEST:
                break
            enough = True
            followed = float(np.cos(2 * np.pi / step * beyond).mean())
            if followed > _FOLLOWED:
                best = float(step)
        looked += enough
        if best:
            combs.append(best)
    if len(combs) >= max(_FREQUENCIES, _SHARE * looked):
        return float(np.median(combs))
    return None


def _luminance(images: NDArray[Any]) -> NDArray[np.float64]:
    """(frames, tiles, rows, cols): what JPEG codes of colour images first."""
    if images.shape[-1] == 1:
        return images[..., 0].astype(np.float64)
    return np.asarray(images @ np.array([0.299, 0.587, 0.114]))


def _blocks(images: NDArray[np.float64]) -> NDArray[np.float64]:
    """Some of the blocks of 8 x 8 that are not all alike, (n, 8, 8)."""
    frames, tiles, rows, cols = images.shape
    rows, cols = rows // BLOCK * BLOCK, cols // BLOCK * BLOCK
    cut = images[:, :, :rows, :cols].reshape(frames, tiles, -1, BLOCK, cols // BLOCK, BLOCK)
    blocks = cut.transpose(0, 1, 2, 4, 3, 5).reshape(-1, BLOCK, BLOCK)
    chosen = np.flatnonzero(np.ptp(blocks, axis=(1, 2)) > 2)
    chosen = np.random.default_rng(0).permutation(chosen)[:_BLOCKS]
    return blocks[chosen]
