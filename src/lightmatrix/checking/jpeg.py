"""Whether photographs went through lossy compression, told from their pixels.

JPEG rounds the cosine transform of each block of 8 x 8 pixels to multiples of a step, one for each
of the 64 frequencies. Decoded, the coefficients still lie on these combs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn

from lightmatrix.checking.finding import Finding
from lightmatrix.checking.survey import BLOCK, Survey

# Steps that are looked for. Rounding to whole levels hides finer ones.
_STEPS = np.arange(3, 128)
# Coefficients that a comb is told from, at least, and how closely they must follow it (the mean
# cosine of their distance to the next tooth, 0 by chance).
_FEWEST, _FOLLOWED = 40, 0.5
# In so many of the frequencies that have enough coefficients.
_SHARE, _FREQUENCIES = 0.5, 6
_BLOCKS = 6000
_FRAMES = 8


def check_jpeg(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Whether the raw levels lie on the combs of JPEG.

    Parameters
    ----------
    survey : Survey
        Only frames of 8 bits are looked at.
    names : sequence of str
        What the frames are called.
    """
    if survey.raw.dtype != np.uint8:
        return []
    frames = np.unique(np.linspace(0, survey.count - 1, _FRAMES).astype(int))
    images = np.moveaxis(survey.raw[:, frames].reshape(*survey.grid, len(frames)), -1, 0)
    step = quantisation(_blocks(_luminance(images)))
    if step is None:
        return []
    lossless = not names[0].lower().endswith((".jpg", ".jpeg"))
    return [
        Finding(
            "jpeg",
            (),
            "the photographs went through JPEG"
            + (", whatever their files are now" if lossless else "")
            + f": in blocks of 8 x 8 they are rounded to steps of about {step:.0f} levels",
            "save raw or lossless files (PNG, TIFF) in the camera's own software; if there is only "
            "JPEG, take its best quality, and say --response srgb if it is not linear",
        )
    ]


def quantisation(blocks: NDArray[np.float64]) -> float | None:
    """The usual step of the combs that blocks lie on; None if they lie on none.

    Parameters
    ----------
    blocks : (n, 8, 8) float64
        Blocks of levels in which none is at either end of the range.
    """
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
    # Ends of the range must stay where they are.
    ends = (images == 0).any(axis=-1) | (images == 255).any(axis=-1)
    return np.asarray(np.where(ends, 0, images @ np.array([0.299, 0.587, 0.114])))


def _blocks(images: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blocks of 8 x 8 that neither clip nor touch zero, (n, 8, 8)."""
    frames, tiles, rows, cols = images.shape
    rows, cols = rows // BLOCK * BLOCK, cols // BLOCK * BLOCK
    cut = images[:, :, :rows, :cols].reshape(frames, tiles, -1, BLOCK, cols // BLOCK, BLOCK)
    blocks = cut.transpose(0, 1, 2, 4, 3, 5).reshape(-1, BLOCK, BLOCK)
    inside = (blocks.min(axis=(1, 2)) > 0) & (blocks.max(axis=(1, 2)) < 255)
    chosen = np.flatnonzero(inside & (np.ptp(blocks, axis=(1, 2)) > 2))
    chosen = np.random.default_rng(0).permutation(chosen)[:_BLOCKS]
    return blocks[chosen]
