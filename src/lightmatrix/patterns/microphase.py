"""Micro phase shifts: sinusoids of short, slightly different periods (Gupta & Nayar 2012)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.phase import check_period, sinusoid
from lightmatrix.patterns.stripes import StripePatterns, Stripes, both_axes, check_code_shape

# The mean period in projector pixels, and the number of patterns for both axes, where none are
# asked for: those of the paper's experiments, of five periods.
USUAL_PERIOD, USUAL_COUNT = 16.0, 14
# Periods lie within this share of their mean, as in the paper: all are then short, which is what
# makes global light the same in all photographs.
_BAND = 0.2
# Sets of periods that are drawn, and their seed. Chosen by hand: they take milliseconds to compare.
_DRAWS, _SEED = 200, 0
# Pixels that are compared with all others, so that large projectors take no longer than a second.
_COMPARED = 128
# The fewest patterns of an axis: three shifts of one period, one of each of two more.
_FEWEST = 5


@dataclass(frozen=True, eq=False)
class MicroPhasePatterns(StripePatterns):
    """Three shifts of one sinusoid and one of each further period; of columns, then of rows.

    All patterns are fine, so that light from many places, as between concave surfaces, adds the
    same amount to each photograph. F periods need F + 2 patterns (Gupta & Nayar 2012, Eq. 9).

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    total : int
        Number of patterns: an equal number, at least 5, for the columns and for the rows.
    period : float
        Mean period in projector pixels, at least 3.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.MicroPhasePatterns((48, 64), period=8).count
    14
    """

    shape: tuple[int, int]
    total: int = USUAL_COUNT
    period: float = USUAL_PERIOD

    def __post_init__(self) -> None:
        check_code_shape(self.shape)
        check_period(self.period * (1 - _BAND))
        axes = len(both_axes(self.shape))
        if self.total % axes or self.total < axes * _FEWEST:
            raise InputError(
                f"{self.total} micro phase shifts for columns and rows",
                hint=f"ask for an even number from {axes * _FEWEST} on, such as {USUAL_COUNT}",
            )

    @cached_property
    def stripes(self) -> Stripes:
        axes, profiles = [], []
        each = self.total // len(both_axes(self.shape))
        for axis, length in both_axes(self.shape):
            periods = _periods(length, each - 2, self.period)
            for profile in _profiles(np.arange(length, dtype=float), periods):
                axes.append(axis)
                profiles.append(profile)
        return Stripes(np.array(axes), tuple(profiles))

    @property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "microphase",
            "shape": list(self.shape),
            "total": self.total,
            "period": self.period,
        }


def _profiles(pixel: NDArray[np.float64], periods: NDArray[np.float64]) -> NDArray[np.float32]:
    """Grey values of all patterns at these pixels, (patterns, pixels)."""
    first = pixel[None, :] / periods[0] - np.arange(3)[:, None] / 3
    return sinusoid(np.concatenate([first, pixel[None, :] / periods[1:, None]]))


def _periods(length: int, count: int, mean: float) -> NDArray[np.float64]:
    """Periods in projector pixels by which distant pixels differ most, (count,).

    Of random sets, the one in which the most similar codes of two pixels, at least half a period
    apart, correlate least.
    """
    draws = np.random.default_rng(_SEED).uniform(1 - _BAND, 1 + _BAND, (_DRAWS, count))
    sets = np.sort(mean * draws, axis=1)
    pixel = np.arange(length, dtype=float)
    some = np.unique(np.linspace(0, length - 1, _COMPARED).astype(np.int64))
    distant = np.abs(pixel[:, None] - pixel[some]) >= mean / 2
    if not distant.any():
        return np.asarray(sets[0])
    alike = []
    for periods in sets:
        codes = _profiles(pixel, periods)
        codes = codes - codes.mean(axis=0)
        codes /= np.maximum(np.linalg.norm(codes, axis=0), 1e-6)
        alike.append(float((codes.T @ codes[:, some])[distant].max()))
    return np.asarray(sets[int(np.argmin(alike))])
