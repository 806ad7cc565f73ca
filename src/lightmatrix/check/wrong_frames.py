"""Which frames show something else than their pattern.

A frame is judged by what its high-variance rows should show, predicted from their other frames.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.finding import Finding, join_names
from lightmatrix.check.prediction import FramePrediction
from lightmatrix.check.survey import robust_deviation, sums_by_group

# A frame is wrong if its prediction misses more than 30 % of its variation; from 12 % on it is
# suspected. A prediction that learned from the frame must miss more than 20 %. If the median frame
# is missed by 30 %, no frame is predicted. Chosen on simulated captures, as all values below:
# `python -m benchmarks.frame_checks`.
WRONG, LIKELY, SUSPECT = 0.3, 0.2, 0.12
# It takes 20 rows to judge a frame, and light must be missing or change by 5 standard errors.
_FEWEST_ROWS, _CERTAIN = 20, 5.0


def wrong_frames(prediction: FramePrediction, share: float = WRONG) -> NDArray[np.bool_]:
    """Which frames miss more than a share of their variation, or are much too dark, (K,)."""
    miss, gain, strength, of_rows = _misses(prediction)
    enough = prediction.trusted.sum(axis=0) >= _FEWEST_ROWS
    # Rows that may be compared are often the dark ones of a frame, the others clip.
    typical = np.median(prediction.expected.mean(axis=0))
    seen = np.where(prediction.trusted, prediction.expected, 0).sum(axis=0)
    lit = seen > 0.1 * typical * np.maximum(prediction.trusted.sum(axis=0), 1)
    usual = float(np.median(miss))
    spread = robust_deviation(np.log(np.maximum(miss, 1e-12)))
    # A wrong frame misses 4 times what the median frame does, and 3 times what its own rows do in
    # all frames: a few rows that are predicted badly, among few that do not clip, are no reason to
    # accuse it (by them, intact frames missed up to 2.3 times as much). Where windows explain
    # little of the light, misses of intact frames differ by factors: it must deviate by 3 robust
    # standard deviations of their logarithms. Of the intact captures of `benchmarks/honesty.py`,
    # accused frames deviated by 1 to 2.7.
    least = np.maximum(max(share, usual * max(4.0, float(np.exp(3 * spread)))), 3 * of_rows)
    wrong = (miss > least) & (usual < WRONG)
    dark = lit & (gain < 0.3) & ((1 - gain) * strength > _CERTAIN)
    return np.asarray(enough & (wrong | dark))


def _misses(prediction: FramePrediction) -> tuple[NDArray[np.float64], ...]:
    """The share of its variation that each frame misses, and its brightness as a share, (K,) each.

    Third comes the light that is expected, in standard errors of its prediction, (K,); last what
    the frame would miss if its rows missed what they do in all frames, (K,).
    Every row counts alike, whatever its albedo and however well it is predicted: the rows that
    reveal a wrong frame are just those that are predicted badly.
    """
    scale = np.maximum(prediction.expected.std(axis=1, keepdims=True), 1e-9)
    expected, observed = prediction.expected / scale, prediction.observed / scale
    trusted = prediction.trusted.astype(np.float64)
    total = np.maximum(trusted.sum(axis=0), 1)
    gain = (trusted * expected * observed).sum(axis=0)
    gain = gain / np.maximum((trusted * expected**2).sum(axis=0), 1e-12)
    # Brightness between half and twice the expected one is corrected, and no row counts for more
    # than 4 of its standard deviations.
    left = np.clip(observed - np.clip(gain, 0.5, 2) * expected, -4, 4)
    # Light that no window explains is smooth over the projector, what a wrong frame shows is not.
    # The mean over the other rows of the same part of the projector is drawn to zero, as if 4 more
    # of its rows missed nothing.
    part = prediction.part
    others = np.maximum(sums_by_group(trusted, part)[part] - trusted, 0)
    left = left - (sums_by_group(trusted * left, part)[part] - trusted * left) / (others + 4)
    usual = expected.mean(axis=1, keepdims=True)
    variation = (trusted * (expected - usual) ** 2).sum(axis=0) / total
    miss = (trusted * left**2).sum(axis=0) / total
    floor = 0.1 * np.median(variation)
    error = np.maximum(
        np.sqrt(prediction.miss)[:, None] * prediction.observed.std(axis=1)[:, None], 1e-9
    )
    strength = np.sqrt((trusted * (prediction.expected / error) ** 2).sum(axis=0))
    variation = np.maximum(variation, max(float(floor), 1e-12))
    of_rows = (trusted * np.minimum(error / scale, 4) ** 2).sum(axis=0) / total
    return miss / variation, gain, strength, of_rows / variation


def check_frames(
    prediction: FramePrediction, wrong: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """State which of the wrong frames (K,) are black, and that the others show something else."""
    seen = prediction.trusted
    light = np.where(seen, prediction.observed, 0).sum(axis=0)
    black = wrong & (light < 0.1 * np.where(seen, prediction.expected, 0).sum(axis=0))
    findings = []
    if black.any():
        findings.append(black_frames(np.flatnonzero(black), names))
    others = np.flatnonzero(wrong & ~black)
    if len(others):
        message = f"{join_names([names[int(k)] for k in others])}: does not show its pattern"
        advice = (
            "look at it: taken during the change of pattern, blurred, moved or covered? Take it "
            "again"
        )
        findings.append(Finding("frame", tuple(map(int, others)), message, advice))
    return findings


def black_frames(frames: Iterable[int], names: Sequence[str]) -> Finding:
    """The finding that frames are black although their patterns are not."""
    message = f"{join_names([names[int(k)] for k in frames])}: black, although the pattern is not"
    advice = "take the photograph again; the projector may have been blank or the shutter shut"
    return Finding("frame", tuple(map(int, frames)), message, advice)
