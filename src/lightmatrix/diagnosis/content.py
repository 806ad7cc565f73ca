"""Whether each photograph shows its own pattern, and what it shows if not.

A frame is judged by what its lively camera pixels should show, predicted from their other frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, listed
from lightmatrix.diagnosis.local import Prediction

# A frame that misses its prediction by more than this share of its variation, and by this many
# times what the usual frame does, shows something else; of less it may be suspected.
WRONG, SUSPECT, _UNUSUAL = 0.3, 0.12, 4.0
# Frames that differ by more in brightness are wrong too. Rows that are odder count no more, in
# units of their spread.
_GAINS, _DARK, _MOST_ODD = (0.5, 2.0), 0.3, 4.0
_FEWEST_ROWS = 20
# Of the light that is expected.
_BLACK = 0.1
# A frame that follows the prediction of another with this correlation, and no third one half as
# well, shows that pattern.
_SHOWN, _OTHERS = 0.5, 0.6


def frame_misses(prediction: Prediction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What each frame misses of its variation, and how bright it is; shares, (K,) each.

    Brightness is set right before. Every row counts alike, whatever its albedo and however well it
    is predicted: it is just the rows that tell a wrong frame that are predicted badly.
    """
    scale = np.maximum(prediction.expected.std(axis=1, keepdims=True), 1e-9)
    expected, observed = prediction.expected / scale, prediction.observed / scale
    seen = prediction.trusted.astype(np.float64)
    total = np.maximum(seen.sum(axis=0), 1)
    gain = (seen * expected * observed).sum(axis=0)
    gain = gain / np.maximum((seen * expected**2).sum(axis=0), 1e-12)
    left = np.clip(observed - np.clip(gain, *_GAINS) * expected, -_MOST_ODD, _MOST_ODD)
    usual = expected.mean(axis=1, keepdims=True)
    variation = (seen * (expected - usual) ** 2).sum(axis=0) / total
    miss = (seen * left**2).sum(axis=0) / total
    floor = 0.1 * np.median(variation)
    return np.asarray(miss / np.maximum(variation, max(float(floor), 1e-12))), np.asarray(gain)


def wrong_frames(prediction: Prediction, share: float = WRONG) -> NDArray[np.bool_]:
    """Which frames show something else than their pattern, (K,).

    Parameters
    ----------
    prediction : Prediction
        Of rows that can be predicted.
    share : float
        Of its variation that a wrong frame misses at least.
    """
    miss, gain = frame_misses(prediction)
    enough = prediction.trusted.sum(axis=0) >= _FEWEST_ROWS
    lit = prediction.expected.mean(axis=0) > 0.1 * np.median(prediction.expected.mean(axis=0))
    wrong = (miss > share) & (miss > _UNUSUAL * np.median(miss))
    return np.asarray(enough & (wrong | (lit & (gain < _DARK))))


def check_content(
    prediction: Prediction, wrong: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """Say what the wrong frames show.

    Parameters
    ----------
    prediction : Prediction
        Of rows that can be predicted.
    wrong : (K,) bool
        Which frames do not show their pattern.
    names : sequence of str
        What the frames are called.
    """
    black: list[int] = []
    others: list[int] = []
    shown: dict[int, int] = {}
    scale = np.maximum(prediction.expected.std(axis=1, keepdims=True), 1e-9)
    expected = (prediction.expected - prediction.expected.mean(axis=1, keepdims=True)) / scale
    expected = expected - expected.mean(axis=0)
    for k in map(int, np.flatnonzero(wrong)):
        seen = prediction.trusted[:, k]
        light = float(prediction.observed[seen, k].sum())
        if light < _BLACK * float(prediction.expected[seen, k].sum()):
            black.append(k)
            continue
        own = (prediction.observed[:, k] - prediction.observed.mean(axis=1)) / scale[:, 0]
        own = (own - own[seen].mean())[seen]
        some = expected[seen]
        power = np.sqrt((own**2).sum() * (some**2).sum(axis=0))
        alike = (own @ some) / np.maximum(power, 1e-12)
        alike[k] = -1
        best = int(alike.argmax())
        if alike[best] > _SHOWN and np.sort(alike)[-2] < _OTHERS * alike[best]:
            shown[k] = best
        else:
            others.append(k)
    found = []
    if black:
        said = listed([names[k] for k in black])
        found.append(
            Finding(
                "frame",
                tuple(black),
                f"{said}: black, although the pattern is not",
                "take the photograph again; the projector may have been blank or the shutter shut",
            )
        )
    for k, other in shown.items():
        if shown.get(other) == k:
            if other > k:
                found.append(
                    Finding(
                        "order",
                        (k, other),
                        f"{names[k]} and {names[other]} look swapped",
                        "give each its own name, or put the images in the order of the patterns",
                    )
                )
            continue
        found.append(
            Finding(
                "order",
                (k,),
                f"{names[k]} shows the pattern of {names[other]}: is it repeated, late or swapped?",
                "take the photograph again, waiting longer after each change of pattern",
            )
        )
    if others:
        found.append(
            Finding(
                "frame",
                tuple(others),
                f"{listed([names[k] for k in others])}: shows neither its pattern nor another's",
                "look at it: taken during the change of pattern, blurred, moved or covered? Take "
                "it again",
            )
        )
    return found
