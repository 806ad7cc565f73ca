"""Several exposures in one capture: which frame has which."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.mix import interleave, parse_shares
from lightmatrix.patterns.pattern_set import PatternSet

EXAMPLE = "1:0.75,0.25:0.25"
# Exposures that are accepted, in any unit. Within this range float32 samples keep their digits.
_SHORTEST, _LONGEST = 1e-12, 1e12


def parse_exposures(text: str) -> list[tuple[float, float]]:
    """Read ``0.8``, or exposures with their shares of the frames, ``1:0.75,0.25:0.25``.

    The pairs of (exposure, share) are positive, and the shares sum to 1.
    """
    pairs = []
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
        pairs.append((exposure, share))
    return pairs


def exposure_sequence(
    exposures: Sequence[tuple[float, float]], patterns: PatternSet
) -> float | NDArray[np.float64]:
    """The exposure of each frame, (K,), or one number if all frames have the same.

    `exposures` are pairs of (exposure, share), as from `parse_exposures`. Exposures alternate
    evenly in their shares (see `interleave`), separately for each kind of pattern in a mix. So
    every exposure sees fine and coarse patterns alike, in every prefix of the capture. With
    ``1:0.75,0.25:0.25`` every fourth pattern of a kind is short, from the third on.
    """
    if len(exposures) == 1:
        return exposures[0][0]
    values = np.array([exposure for exposure, _ in exposures])
    shares = [share for _, share in exposures]
    sequence = np.empty(patterns.count)
    for kind in np.unique(patterns.kinds):
        frames = np.flatnonzero(patterns.kinds == kind)
        sequence[frames] = values[interleave(shares, len(frames))]
    return sequence
