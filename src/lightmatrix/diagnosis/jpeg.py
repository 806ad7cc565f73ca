"""Whether the pixels of photographs show lossy compression.

JPEG rounds the cosine transform of each block of 8 x 8 pixels to multiples of a step, one for each
of the 64 frequencies. Rounding again by the same steps changes hardly anything, even where levels
were cut off at the ends of the range: photographs that are compressed again at the same quality
come out nearly as they went in, and at no other quality. A camera with its own table of steps
shows as coefficients that lie on combs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.survey import BLOCK, Survey

# Combs are searched with steps of 3 to 127 levels; rounding to whole levels hides finer ones.
_STEPS = np.arange(3, 128)
# A comb needs 40 coefficients, which follow it with a mean cosine of their distance to the next
# tooth of at least 0.5; by chance it is 0. Half of the frequencies with enough coefficients must
# lie on combs, and at least 6.
_FEWEST_COEFFICIENTS, _FOLLOWED = 40, 0.5
_COMB_SHARE, _FEWEST_COMBS = 0.5, 6
# Up to 3000 blocks of up to 8 frames are looked at; more take longer.
_BLOCKS = 3000
_FRAMES = 8
# The steps for luminance at quality 50 (ITU T.81, Annex K), which libjpeg scales by the quality.
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
# From quality 96 on steps are 1 and photographs as good as lossless.
_QUALITIES = range(20, 96)
# Compressing again at the quality of the first time must change less than 60 % of what it changes
# at qualities 5 lower and higher.
_DIP, _REACH = 0.6, 5


def check_jpeg(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Whether the raw levels were rounded as JPEG does, in frames of 8 bits and a block or more."""
    if survey.raw.dtype != np.uint8 or min(survey.grid[1:3]) < BLOCK:
        return []
    frames = np.unique(np.linspace(0, survey.count - 1, _FRAMES).astype(int))
    images = np.moveaxis(survey.raw[:, frames].reshape(*survey.grid, len(frames)), -1, 0)
    blocks = _blocks(_luminance(images))
    quality = likely_quality(blocks)
    step = None if quality else comb_step(blocks)
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
            "JPEG, take its best quality, and give --response srgb if it is not linear",
        )
    ]


def likely_quality(blocks: NDArray[np.floating]) -> int | None:
    """The quality at which libjpeg's table compressed blocks (n, 8, 8) of levels, if any."""
    if len(blocks) < _FEWEST_COEFFICIENTS:
        return None
    coefficients = dctn(blocks - 128, axes=(1, 2), norm="ortho")
    change = []
    for quality in _QUALITIES:
        steps = _steps(quality)
        again = idctn(steps * np.rint(coefficients / steps), axes=(1, 2), norm="ortho") + 128
        change.append(float(np.mean((np.rint(again).clip(0, 255) - blocks) ** 2)))
    # Photographs that were never compressed change less and less as the quality rises.
    for k in range(_REACH, len(change) - _REACH):
        around = min(change[k - _REACH], change[k + _REACH])
        near = change[k - _REACH : k + _REACH + 1]
        if change[k] == min(near) and change[k] < _DIP * around:
            return _QUALITIES[k]
    return None


def _steps(quality: int) -> NDArray[np.float32]:
    """The steps by which libjpeg rounds the frequencies of the luminance, (8, 8)."""
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    return np.clip((_TABLE * scale + 50) // 100, 1, 255).astype(np.float32)


def comb_step(blocks: NDArray[np.floating]) -> float | None:
    """The median step of the combs that blocks (n, 8, 8) of levels lie on; None if on none."""
    # Levels that were cut off lie on no comb.
    blocks = blocks[(blocks.min(axis=(1, 2)) > 0) & (blocks.max(axis=(1, 2)) < 255)]
    if not len(blocks):
        return None
    coefficients = dctn(blocks, axes=(1, 2), norm="ortho").reshape(-1, BLOCK * BLOCK)
    frequencies, combs = 0, []
    # The mean of a block, the first, is left out: flat areas put it on a comb by chance.
    for values in np.abs(coefficients.T[1:]).astype(np.float32):
        # A comb of only one tooth, at zero, is a smooth image.
        beyond = values > _STEPS[:, None] / 2
        count = beyond.sum(axis=1)
        steps = _STEPS[count >= _FEWEST_COEFFICIENTS]
        waves = np.cos((2 * np.pi / steps).astype(np.float32)[:, None] * values)
        mean = (waves * beyond[: len(steps)]).sum(axis=1) / count[: len(steps)]
        followed = mean > _FOLLOWED
        frequencies += bool(len(steps))
        if followed.any():
            combs.append(float(steps[followed][-1]))
    if len(combs) >= max(_FEWEST_COMBS, _COMB_SHARE * frequencies):
        return float(np.median(combs))
    return None


def _luminance(images: NDArray[Any]) -> NDArray[np.float32]:
    """The luminance (frames, tiles, rows, cols), which JPEG codes first."""
    if images.shape[-1] == 1:
        return images[..., 0].astype(np.float32)
    return np.asarray(images @ np.array([0.299, 0.587, 0.114], np.float32))


def _blocks(images: NDArray[np.floating]) -> NDArray[np.floating]:
    """Some of the blocks that are not uniform, (n, 8, 8)."""
    frames, tiles, rows, cols = images.shape
    rows, cols = rows // BLOCK * BLOCK, cols // BLOCK * BLOCK
    cut = images[:, :, :rows, :cols].reshape(frames, tiles, -1, BLOCK, cols // BLOCK, BLOCK)
    blocks = cut.transpose(0, 1, 2, 4, 3, 5).reshape(-1, BLOCK, BLOCK)
    chosen = np.flatnonzero(np.ptp(blocks, axis=(1, 2)) > 2)
    chosen = np.random.default_rng(0).permutation(chosen)[:_BLOCKS]
    return blocks[chosen]
