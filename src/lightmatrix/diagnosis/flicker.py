"""Whether the light was the same in every frame.

Light that differs in a frame makes all of its samples brighter or darker by one share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, join_names
from lightmatrix.diagnosis.prediction import FramePrediction
from lightmatrix.diagnosis.statistics import robust_deviation, sums_by_group

# A standard deviation of the light of up to 1.2 % does no harm; a single frame is named from 4 %
# on, and only if it deviates by 6 times what frames usually do. A deviation counts if it exceeds 5
# standard errors. Chosen on simulated captures: `python -m benchmarks.frame_checks`.
_HARMLESS, _NAMED, _OUTLYING = 0.012, 0.04, 6
_CERTAIN = 5.0
# Samples measure the light where they reach 30 % of the row's brightest one, which they must do in
# 20 rows; a share of a dark sample says nothing. No sample counts for more than 6 standard
# deviations, so that one odd pixel decides nothing.
_LIT, _FEWEST_ROWS, _MOST_DEVIATIONS = 0.3, 20, 6
# Predictions of blurred light miss much that is alike in many rows, and looks like a change of the
# light. Above 4 % of the variance a frame counts only if a change explains half of what its rows
# miss, and none does if all changes together explain less than 30 %.
# Chosen on captures with and without drifting light (`benchmarks/synthetic_captures.py`).
_MUCH, _EXPLAINED, _EXPLAINED_OF_ALL = 0.04, 0.5, 0.3


def brightness_changes(
    prediction: FramePrediction,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much brighter each frame is than predicted, and the standard error; shares, (K,) each."""
    noise, expected = prediction.noise, prediction.expected
    lit = expected > _LIT * expected.max(axis=1, keepdims=True)
    weight = (prediction.trusted & lit) / noise**2
    deviations = (prediction.observed - expected) / noise
    left = np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS) * noise
    power = np.maximum((weight * expected**2).sum(axis=0), 1e-12)
    change = (weight * left * expected).sum(axis=0) / power
    rest = weight * expected * (left - change * expected)
    # Rows of one part of the projector miss the same light, which would look like many witnesses.
    error = np.sqrt((sums_by_group(rest, prediction.part) ** 2).sum(axis=0)) / power
    enough = (weight > 0).sum(axis=0) >= _FEWEST_ROWS
    if float(np.median(prediction.miss)) > _MUCH:
        missed, explained = (weight * left**2).sum(axis=0), change**2 * power
        enough &= explained > _EXPLAINED * missed
        enough &= explained[enough].sum() > _EXPLAINED_OF_ALL * missed.sum()
    return np.where(enough, change, 0), np.where(enough, error, np.inf)


def check_flicker(
    change: NDArray[np.float64],
    error: NDArray[np.float64],
    frames: NDArray[np.int64],
    names: Sequence[str],
) -> list[Finding]:
    """Whether some of the `frames` (k,), or all, change by more than their `error` (k,)."""
    if len(change) < 4:
        return []
    certain = np.abs(change) > _CERTAIN * error
    usual = robust_deviation(change)
    if usual > _HARMLESS and certain.mean() > 0.3:
        worst = int(np.argmax(np.abs(change)))
        spread = float(np.sqrt(np.mean(np.clip(change, -4 * usual, 4 * usual) ** 2)))
        return [
            Finding(
                "flicker",
                (),
                f"the light varies from frame to frame by {100 * spread:.1f} % (standard "
                f"deviation; most in {names[frames[worst]]}, {100 * change[worst]:+.0f} %)",
                "expose for whole periods of the mains and of the projector (1/50 or 1/60 s and "
                "multiples), turn automatic exposure and dynamic contrast off, and let lamps warm "
                "up; if the exposures differed, state them",
            )
        ]
    odd = np.flatnonzero(certain & (np.abs(change) > max(_NAMED, _OUTLYING * usual)))
    if not len(odd):
        return []
    words = [f"{names[frames[k]]} ({100 * change[k]:+.0f} %)" for k in odd]
    return [
        Finding(
            "flicker",
            tuple(int(frames[k]) for k in odd),
            f"the light is not that of the other frames in {join_names(words)}",
            "take these frames again, with automatic exposure off; if their exposure differed, "
            "state it in capture.json",
        )
    ]
