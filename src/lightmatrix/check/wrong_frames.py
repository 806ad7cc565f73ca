"""Which frames show something else than their pattern, and whether all have the same light.

A frame is judged by what its high-variance rows should show, predicted from their other frames.
Light that differs in a frame makes all of its samples brighter or darker by one share.
"""

from __future__ import annotations

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
    of_rows = (trusted * (error / scale) ** 2).sum(axis=0) / total
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


def brightness_changes(
    prediction: FramePrediction,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much brighter each frame is than predicted, and the standard error; shares, (K,) each."""
    noise, expected = prediction.noise, prediction.expected
    lit = expected > 0.3 * expected.max(axis=1, keepdims=True)
    weight = (prediction.trusted & lit) / noise**2
    deviations = (prediction.observed - expected) / noise
    left = np.clip(deviations, -6, 6) * noise
    power = np.maximum((weight * expected**2).sum(axis=0), 1e-12)
    change = (weight * left * expected).sum(axis=0) / power
    rest = weight * expected * (left - change * expected)
    # Rows of one part of the projector miss the same light, which would look like many witnesses.
    error = np.sqrt((sums_by_group(rest, prediction.part) ** 2).sum(axis=0)) / power
    enough = (weight > 0).sum(axis=0) >= _FEWEST_ROWS
    # Predictions of blurred light miss much that is alike in many rows, and looks like a change of
    # the light. A frame then counts only if a change explains half of what its rows miss, and none
    # does if all changes together explain less than 30 %. Chosen on captures with and without
    # drifting light (`benchmarks/synthetic_captures.py`).
    if float(np.median(prediction.miss)) > 0.04:
        missed, explained = (weight * left**2).sum(axis=0), change**2 * power
        enough &= explained > 0.5 * missed
        enough &= explained[enough].sum() > 0.3 * missed.sum()
    return np.where(enough, change, 0), np.where(enough, error, np.inf)


def check_flicker(
    change: NDArray[np.float64],
    error: NDArray[np.float64],
    frames: NDArray[np.int64],
    names: Sequence[str],
    slack: float = 1.0,
) -> list[Finding]:
    """Whether some of the `frames` (k,), or all, change by more than their `error` (k,).

    The least change that is named is in proportion to `slack`.
    """
    if len(change) < 4:
        return []
    certain = np.abs(change) > _CERTAIN * error
    usual = robust_deviation(change)
    # A standard deviation of the light of up to 1.2 % does no harm.
    if usual > 0.012 * slack and certain.mean() > 0.3:
        worst = int(np.argmax(np.abs(change)))
        spread = float(np.sqrt(np.mean(np.clip(change, -4 * usual, 4 * usual) ** 2)))
        message = (
            f"the light varies from frame to frame by {100 * spread:.1f} % (standard deviation; "
            f"most in {names[frames[worst]]}, {100 * change[worst]:+.0f} %)"
        )
        advice = (
            "expose for whole periods of the mains and of the projector (1/50 or 1/60 s and "
            "multiples), turn automatic exposure and dynamic contrast off, and let lamps warm up; "
            "if the exposures differed, state them"
        )
        return [Finding("flicker", (), message, advice)]
    odd = np.flatnonzero(certain & (np.abs(change) > max(0.04 * slack, 6 * usual)))
    if not len(odd):
        return []
    words = [f"{names[frames[k]]} ({100 * change[k]:+.0f} %)" for k in odd]
    message = f"the light is not that of the other frames in {join_names(words)}"
    advice = (
        "take these frames again, with automatic exposure off; if their exposure differed, state "
        "it in capture.json"
    )
    return [Finding("flicker", tuple(map(int, frames[odd])), message, advice)]
