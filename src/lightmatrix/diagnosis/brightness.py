"""Whether the light was the same in every frame.

Every camera pixel is predicted from its own other frames, with an error of its own. Light that
differs in a frame makes all of its samples brighter or darker by one share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, listed
from lightmatrix.diagnosis.local import Prediction

# Smaller variations do no harm; of larger ones a single frame is named.
_HARMLESS, _NAMED = 0.012, 0.04
# Standard errors that a variation must have to count.
_CERTAIN = 5.0
# Of a row's brightest sample, where light counts, and in how many rows it has to.
_LIT, _FEWEST = 0.3, 20


def gains(prediction: Prediction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much brighter each frame is than predicted, and the standard error; (K,) each.

    Both as shares; 0 and infinity for frames with hardly a lit sample.
    """
    noise = prediction.noise
    weight = prediction.trusted / noise**2
    # One odd pixel must not decide.
    left = np.clip((prediction.observed - prediction.expected) / noise, -6, 6) * noise
    # Of dark samples a share says nothing.
    most = prediction.expected.max(axis=1, keepdims=True)
    weight = np.where(prediction.expected > _LIT * most, weight, 0)
    power = (weight * prediction.expected**2).sum(axis=0)
    found = (weight * left * prediction.expected).sum(axis=0) / np.maximum(power, 1e-12)
    rest = weight * prediction.expected * (left - found * prediction.expected)
    error = np.sqrt((rest**2).sum(axis=0)) / np.maximum(power, 1e-12)
    enough = (weight > 0).sum(axis=0) >= _FEWEST
    return np.where(enough, found, 0), np.where(enough, error, np.inf)


def check_brightness(
    found: NDArray[np.float64],
    error: NDArray[np.float64],
    frames: NDArray[np.int64],
    names: Sequence[str],
) -> list[Finding]:
    """Whether some frames, or all of them in turn, are brighter or darker than they should be.

    Parameters
    ----------
    found, error : (k,) float64
        How much brighter each frame is, as a share, and its standard error; see `gains`.
    frames : (k,) int
        Which frames these are.
    names : sequence of str
        What the frames are called.
    """
    certain = np.abs(found) > _CERTAIN * error
    if len(found) < 4:
        return []
    usual = 1.4826 * float(np.median(np.abs(found - np.median(found))))
    if usual > _HARMLESS and certain.mean() > 0.3:
        worst = int(np.argmax(np.abs(found)))
        spread = float(np.sqrt(np.mean(np.clip(found, -4 * usual, 4 * usual) ** 2)))
        return [
            Finding(
                "flicker",
                (),
                f"the light varies from frame to frame by {100 * spread:.1f} % (standard "
                f"deviation; most in {names[frames[worst]]}, {100 * found[worst]:+.0f} %)",
                "expose for whole periods of the mains and of the projector (1/50 or 1/60 s and "
                "multiples), turn automatic exposure and dynamic contrast off, and let lamps warm "
                "up; if the exposures differed, say them",
            )
        ]
    odd = np.flatnonzero(certain & (np.abs(found) > max(_NAMED, 6 * usual)))
    if not len(odd):
        return []
    words = [f"{names[frames[k]]} ({100 * found[k]:+.0f} %)" for k in odd]
    return [
        Finding(
            "flicker",
            tuple(int(frames[k]) for k in odd),
            f"the light is not that of the other frames in {listed(words)}",
            "take these frames again, with automatic exposure off; if their exposure differed, "
            "say so in capture.json",
        )
    ]
