"""Projector pixels that all patterns show alike, so that no photograph tells them apart."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

# Pixels at most this far apart, in rows and columns, count as one: camera pixels often see both.
NEAR = 1
# Values that differ by less than 2 % are the same.
SAME = 0.02
# Mixtures of values that differ by less than this share are the same but for rounding.
_ROUNDING = 1e-9


def varying_axes(images: Iterable[NDArray[np.float32]]) -> tuple[bool, bool]:
    """Whether any of the patterns, in blocks of (k, rows, cols), varies along rows and columns."""
    varies = [False, False]
    for block in images:
        for axis in (0, 1):
            varies[axis] |= bool((np.ptp(block, axis=1 + axis) > SAME).any())
        if all(varies):
            break
    return varies[0], varies[1]


def of_surroundings(mixed: NDArray[np.float64]) -> NDArray[np.float64]:
    """A mixture of each pixel with its eight neighbours, (rows, cols).

    It is the same where the surroundings are, also if they are mirrored.
    """
    corner, beside, above, centre = np.random.default_rng(1).standard_normal(4)
    kernel = [[corner, above, corner], [beside, centre, beside], [corner, above, corner]]
    return np.asarray(convolve(mixed, np.array(kernel), mode="nearest"))


def groups(mixed: NDArray[np.float64]) -> NDArray[np.int64]:
    """The number of each pixel's group of pixels of the same mixture, (N,)."""
    order = np.argsort(mixed, kind="stable")
    step = np.diff(mixed[order]) >= _ROUNDING * max(1.0, float(np.abs(mixed).max()))
    group = np.empty(len(mixed), np.int64)
    group[order] = np.concatenate([[0], np.cumsum(step)])
    return group


def far_twins(
    group: NDArray[np.int64], shape: tuple[int, int], axes: tuple[bool, bool]
) -> NDArray[np.bool_]:
    """Whether a pixel of the same group lies more than a pixel away along one of the axes, (N,)."""
    far = np.zeros(len(group), np.bool_)
    count = int(group.max()) + 1
    for place, counts in zip(np.divmod(np.arange(len(group)), shape[1]), axes, strict=True):
        if not counts:
            continue
        for away in (place, -place):
            least = np.full(count, np.iinfo(np.int64).max)
            np.minimum.at(least, group, away)
            far |= away - least[group] > NEAR
    return far
