"""Exposures of frames: which frame has which, how much each weighs, and its share of white."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import EXPOSURES_EXAMPLE, USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.patterns.mix import interleave, parse_shares
from lightmatrix.patterns.pattern_set import PatternSet


def lit_samples(
    white: NDArray[np.floating], black: NDArray[np.floating], clip_level: float
) -> NDArray[np.bool_]:
    """Samples that the projector lights well and that do not clip under white, as a frame.

    `white` and `black` are the levels under a white and a black pattern.
    """
    light = white - black
    # The noise of a sample is several times smaller than 2 % of the clip level.
    unclipped = white < 0.98 * clip_level
    # Samples of less than a tenth of the brightest light add noise and hardly any light. A quantile
    # stands for the brightest, so that single glints do not set the measure.
    return np.asarray(unclipped & (light > 0.1 * np.quantile(light, 0.99)))


def share_of_white(
    frame: NDArray[np.generic],
    white: NDArray[np.floating],
    black: NDArray[np.floating],
    lit: NDArray[np.bool_],
) -> float:
    """How far a frame is from black (0) to white (1): a least-squares fit over the lit samples."""
    light = (white - black)[lit].astype(np.float64)
    above = np.asarray(frame, np.float64)[lit] - black[lit]
    return float(above @ light / (light @ light))


# Standard deviation of what a sparse row cannot explain, as a share of the clip level of the
# longest exposure. For most samples this misfit exceeds the noise; weights by the noise alone,
# e^2, would nearly discard short exposures. docs/planning.md compares it with 0 and 1000:
# `python -m benchmarks.exposures --misfit 0`.
MISFIT = 0.03


def frame_weights(exposures: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Weights in the data term of K frames of different exposures e, (K,); None if all are equal.

    Dividing a sample by its exposure multiplies its noise by 1/e. Weights are relative to the
    longest exposure, so that equal exposures weigh 1, however long they are.
    """
    relative = exposures / exposures.max()
    if (relative == 1).all():
        return None
    variance = MISFIT**2 + (USUAL_NOISE / relative) ** 2
    return np.asarray(variance.min() / variance, np.float32)


def parse_exposures(text: str) -> list[tuple[float, float]]:
    """Read ``0.8``, or exposures with their shares of the frames, ``1:0.75,0.25:0.25``.

    The pairs of (exposure, share) are positive, and the shares sum to 1.
    """
    pairs = []
    for name, share in parse_shares(text, "an exposure", EXPOSURES_EXAMPLE):
        try:
            exposure = float(name)
        except ValueError:
            exposure = math.nan
        # In this range, in whatever unit, float32 samples keep their digits.
        if not 1e-12 <= exposure <= 1e12:
            hint = f"use positive numbers, such as 1, or several: {EXPOSURES_EXAMPLE}"
            raise InputError(f"an exposure of {name!r}", hint=hint)
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
