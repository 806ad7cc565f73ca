"""Several exposures in one capture: which frame gets which."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.shares import interleave, parse_shares

EXAMPLE = "1:0.75,0.25:0.25"
# In any unit that a camera is set in; float32 samples keep their digits.
_SHORTEST, _LONGEST = 1e-12, 1e12


def parse_exposures(text: str) -> list[tuple[float, float]]:
    """Read ``0.8``, or exposures and their shares of the frames: ``1:0.75,0.25:0.25``.

    Returns
    -------
    list of (exposure, share)
        Both > 0; the shares sum to 1.

    Raises
    ------
    InputError
        On exposures that are no positive numbers or beyond 1e12, and shares that do not sum to 1.
    """
    result = []
    for name, share in parse_shares(text, "an exposure", EXAMPLE):
        try:
            exposure = float(name)
        except ValueError:
            exposure = math.nan
        if not _SHORTEST <= exposure <= _LONGEST:
            raise InputError(
                f"an exposure of {name!r}",
                hint=f"use positive numbers, such as 1, or several: {EXAMPLE}",
            )
        result.append((exposure, share))
    return result


def exposure_sequence(
    exposures: Sequence[tuple[float, float]], patterns: PatternSet
) -> float | NDArray[np.float64]:
    """The exposure of each frame; one number where all have one.

    Exposures follow each other evenly in their shares (see `interleave`), apart for each kind of
    pattern of a mix: every exposure sees fine and coarse patterns alike, in every prefix. With
    ``1:0.75,0.25:0.25`` every fourth pattern of a kind is short, from the third on.

    Parameters
    ----------
    exposures : sequence of (exposure, share)
        As from `parse_exposures`.
    patterns : PatternSet
        K patterns, in the order of the frames.

    Returns
    -------
    float or (K,) float64
    """
    if len(exposures) == 1:
        return exposures[0][0]
    values = np.array([exposure for exposure, _ in exposures])
    shares = [share for _, share in exposures]
    result = np.empty(patterns.count)
    for kind in np.unique(patterns.kinds):
        frames = np.flatnonzero(patterns.kinds == kind)
        result[frames] = values[interleave(shares, len(frames))]
    return result
