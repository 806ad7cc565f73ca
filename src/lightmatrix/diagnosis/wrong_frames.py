"""Which frames show something else than their pattern, though not that of another frame.

A frame is judged by what its high-variance rows should show, predicted from their other frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, join_names
from lightmatrix.diagnosis.prediction import FramePrediction
from lightmatrix.diagnosis.statistics import robust_deviation, sums_by_group

# A frame is wrong if its prediction misses more than 30 % of its variation and 4 times what that of
# the median frame does; from 12 % on it is suspected. It takes 20 rows to judge a frame. Chosen on
# simulated captures: `python -m benchmarks.frame_checks`. A prediction that learned from the frame
# must miss more than 20 %. If the median frame is missed by 30 %, no frame is predicted.
WRONG, LIKELY, SUSPECT, _UNUSUAL = 0.3, 0.2, 0.12, 4.0
_FEWEST_ROWS = 20
# Brightness between half and twice the expected one is corrected first. A frame is wrong, too, if
# it is less than 30 % as bright as expected, where at least a tenth of the median frame's light is
# expected. No row counts for more than 4 of its standard deviations.
_GAINS, _DARK, _LIT, _MOST_DEVIATIONS = (0.5, 2.0), 0.3, 0.1, 4.0
# The mean of a part of the projector is drawn to zero, as if 4 more of its rows missed nothing.
_FEW_OTHERS = 4
# Where windows explain little of the light, misses of intact frames differ by factors: a wrong one
# must deviate by 3 robust standard deviations of their logarithms. Chosen on intact captures
# (`benchmarks/honesty.py`), of which the accused frames deviated by 1 to 2.7.
_DEVIATIONS = 3.0
# The light that is missing must be as large as 5 standard errors of the prediction.
_CERTAIN = 5.0
# Black frames have less than 10 % of the expected light.
_BLACK = 0.1


def wrong_frames(prediction: FramePrediction, share: float = WRONG) -> NDArray[np.bool_]:
    """Which frames miss more than a share of their variation, or are much too dark, (K,)."""
    miss, gain, strength = _misses(prediction)
    enough = prediction.trusted.sum(axis=0) >= _FEWEST_ROWS
    # Rows that may be compared are often the dark ones of a frame, the others clip.
    typical = np.median(prediction.expected.mean(axis=0))
    seen = np.where(prediction.trusted, prediction.expected, 0).sum(axis=0)
    lit = seen > _LIT * typical * np.maximum(prediction.trusted.sum(axis=0), 1)
    usual = float(np.median(miss))
    spread = robust_deviation(np.log(np.maximum(miss, 1e-12)))
    least = max(share, usual * max(_UNUSUAL, float(np.exp(_DEVIATIONS * spread))))
    wrong = (miss > least) & (usual < WRONG)
    dark = lit & (gain < _DARK) & ((1 - gain) * strength > _CERTAIN)
    return np.asarray(enough & (wrong | dark))


def _misses(prediction: FramePrediction) -> tuple[NDArray[np.float64], ...]:
    """The share of its variation that each frame misses, and its brightness as a share, (K,) each.

    Third comes the light that is expected, in standard errors of its prediction, (K,).
    Every row counts alike, whatever its albedo and however well it is predicted: the rows that
    reveal a wrong frame are just those that are predicted badly.
    """
    scale = np.maximum(prediction.expected.std(axis=1, keepdims=True), 1e-9)
    expected, observed = prediction.expected / scale, prediction.observed / scale
    trusted = prediction.trusted.astype(np.float64)
    total = np.maximum(trusted.sum(axis=0), 1)
    gain = (trusted * expected * observed).sum(axis=0)
    gain = gain / np.maximum((trusted * expected**2).sum(axis=0), 1e-12)
    left = observed - np.clip(gain, *_GAINS) * expected
    left = np.clip(left, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)
    # Light that no window explains is smooth over the projector, what a wrong frame shows is not.
    left = left - _part_means(left, trusted, prediction.part)
    usual = expected.mean(axis=1, keepdims=True)
    variation = (trusted * (expected - usual) ** 2).sum(axis=0) / total
    miss = (trusted * left**2).sum(axis=0) / total
    floor = 0.1 * np.median(variation)
    error = np.maximum(
        np.sqrt(prediction.miss)[:, None] * prediction.observed.std(axis=1)[:, None], 1e-9
    )
    strength = np.sqrt((trusted * (prediction.expected / error) ** 2).sum(axis=0))
    return miss / np.maximum(variation, max(float(floor), 1e-12)), gain, strength


def _part_means(
    left: NDArray[np.float64], trusted: NDArray[np.float64], part: NDArray[np.int64]
) -> NDArray[np.float64]:
    """The mean of what is left in the other rows of the same part of the projector, (m, K)."""
    others = np.maximum(sums_by_group(trusted, part)[part] - trusted, 0)
    total = sums_by_group(trusted * left, part)[part] - trusted * left
    return np.asarray(total / (others + _FEW_OTHERS))


def check_frames(
    prediction: FramePrediction, wrong: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """State which of the wrong frames (K,) are black, and that the others show something else."""
    seen = prediction.trusted
    light = np.where(seen, prediction.observed, 0).sum(axis=0)
    black = wrong & (light < _BLACK * np.where(seen, prediction.expected, 0).sum(axis=0))
    findings = []
    if black.any():
        findings.append(black_frames(np.flatnonzero(black), names))
    others = np.flatnonzero(wrong & ~black)
    if len(others):
        findings.append(
            Finding(
                "frame",
                tuple(map(int, others)),
                f"{join_names([names[int(k)] for k in others])}: does not show its pattern",
                "look at it: taken during the change of pattern, blurred, moved or covered? Take "
                "it again",
            )
        )
    return findings


def black_frames(frames: Iterable[int], names: Sequence[str]) -> Finding:
    """The finding that frames are black although their patterns are not."""
    return Finding(
        "frame",
        tuple(map(int, frames)),
        f"{join_names([names[int(k)] for k in frames])}: black, although the pattern is not",
        "take the photograph again; the projector may have been blank or the shutter shut",
    )
