"""Patterns of stripes: each varies along the projector's columns, or along its rows, or not at all.

The codes of structured light are of this kind: Gray code, phase shifts, micro phase shifts.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet

# What a pattern varies along: its columns (upright stripes), its rows, or nothing (white, black).
COLUMNS, ROWS, NOTHING = 1, 0, -1
# Pixels of a stripe are the same if they differ by at most this share of white: saving grey values
# with 8 bits and a projector's response curve leave no difference, lossy compression a small one.
_SAME = 0.02


@dataclass(frozen=True, eq=False)
class Stripes:
    """K patterns of stripes, each by the values along what it varies.

    Parameters
    ----------
    axes : (K,) int
        COLUMNS, ROWS or NOTHING for each pattern.
    profiles : tuple of K arrays, float32
        (cols,) values along the columns, (rows,) along the rows, or (1,) of a uniform pattern.
    """

    axes: NDArray[np.int64]
    profiles: tuple[NDArray[np.float32], ...]


class StripePatterns(PatternSet):
    """Patterns of stripes as an operator: sums over rows or columns, then a small product."""

    @property
    @abstractmethod
    def stripes(self) -> Stripes:
        """Axis and profile of each pattern."""

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.stripes.profiles)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        images = x.reshape(len(x), *self.shape)
        sums = {ROWS: images.sum(axis=2), COLUMNS: images.sum(axis=1)}
        samples = np.empty((len(x), self.count), x.dtype)
        for axis, light in sums.items():
            frames, profiles = self._along(axis)
            samples[:, frames] = light @ profiles.astype(x.dtype).T
        return samples

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        parts = []
        for axis in (ROWS, COLUMNS):
            frames, profiles = self._along(axis)
            parts.append(e[:, frames] @ profiles.astype(e.dtype))
        return np.asarray(parts[0][:, :, None] + parts[1][:, None, :]).reshape(len(e), self.pixels)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        place = np.divmod(np.asarray(index, np.int64), self.shape[1])
        values = np.empty((self.count, len(place[0])), np.float32)
        for axis in (ROWS, COLUMNS):
            frames, profiles = self._along(axis)
            values[frames] = profiles[:, place[axis]]
        return values

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        images = np.empty((min(stop, self.count) - start, *self.shape), np.float32)
        for k, image in enumerate(images, start):
            profile = self.stripes.profiles[k]
            image[:] = profile[:, None] if self.stripes.axes[k] == ROWS else profile
        return images.reshape(len(images), self.pixels)

    def _along(self, axis: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The patterns that vary along an axis, with uniform ones among the rows; their values."""
        return self._sorted[axis]

    @cached_property
    def _sorted(self) -> dict[int, tuple[NDArray[np.int64], NDArray[np.float32]]]:
        result = {}
        for axis in (ROWS, COLUMNS):
            chosen = self.stripes.axes == axis
            if axis == ROWS:
                chosen |= self.stripes.axes == NOTHING
            frames = np.flatnonzero(chosen)
            values = np.empty((len(frames), self.shape[axis]), np.float32)
            for value, k in zip(values, frames, strict=True):
                value[:] = self.stripes.profiles[k]
            result[axis] = frames, values
        return result


def stripes_of(patterns: PatternSet) -> Stripes | None:
    """The patterns as stripes; None if one of them varies along both rows and columns."""
    if isinstance(patterns, StripePatterns):
        return patterns.stripes
    axes, profiles = [], []
    for k in range(patterns.count):
        image = patterns.images(k, k + 1)[0]
        # A pattern of two rows that differ varies along rows, one of equal rows does not.
        upright = bool((np.abs(image - image[:1]) <= _SAME).all())
        level = bool((np.abs(image - image[:, :1]) <= _SAME).all())
        if upright and level:
            axes.append(NOTHING)
            profiles.append(np.full(1, image.mean(), np.float32))
        elif upright or level:
            axes.append(COLUMNS if upright else ROWS)
            profiles.append(image.mean(axis=0 if upright else 1, dtype=np.float32))
        else:
            return None
    return Stripes(np.array(axes), tuple(profiles))


def check_code_shape(shape: tuple[int, int]) -> None:
    """Refuse projectors of one pixel, which nothing can encode."""
    if len(shape) != 2 or min(shape) < 1 or max(shape) < 2:
        raise InputError(
            f"a code for a projector of shape {shape}", hint="give (rows, cols), one above 1"
        )


def both_axes(shape: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """Axis and length of the columns, then of the rows; an axis of one pixel needs no code."""
    lengths = ((COLUMNS, shape[1]), (ROWS, shape[0]))
    return tuple((axis, length) for axis, length in lengths if length > 1)


def is_separable(patterns: PatternSet) -> bool:
    """Whether no pattern varies along both rows and columns."""
    if min(patterns.shape) == 1:
        return False
    stripes = stripes_of(patterns)
    return stripes is not None and bool((stripes.axes != NOTHING).any())
