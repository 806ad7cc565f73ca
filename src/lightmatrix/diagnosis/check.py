"""All checks of a capture, one after the other, each knowing what those before it found."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.brightness import check_brightness, gains
from lightmatrix.diagnosis.content import SUSPECT, check_content, wrong_frames
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.identity import check_interchanged, check_patterns
from lightmatrix.diagnosis.jpeg import check_jpeg
from lightmatrix.diagnosis.levels import check_light, check_plain_frames
from lightmatrix.diagnosis.local import Prediction, predict
from lightmatrix.diagnosis.motion import check_motion
from lightmatrix.diagnosis.order import Disorder, find_disorder
from lightmatrix.diagnosis.pairs import Pairs, check_pairs, pair_gains
from lightmatrix.diagnosis.response import check_response
from lightmatrix.diagnosis.rows import lively_rows
from lightmatrix.diagnosis.survey import Survey

# Nothing is told from fewer frames, or fewer camera pixels that can be predicted.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 20
# More odd frames than this share have something in common.
_FEW = 0.25
# Gains told from inverse pairs, medians over many pixels, are as exact as the camera is linear.
_PAIR_ERROR = 0.004

# The last says whether the light is looked at, too: None, no; False, but for its response, since
# JPEG rounds dark and bright by other steps, which looks like a gamma.
How = Callable[[Survey, NDArray[np.int64], Sequence[str], bool | None], list[Finding]]


def check_survey(
    survey: Survey, names: Sequence[str], *, order_only: bool = False
) -> list[Finding]:
    """Everything that seems wrong with what was surveyed of a capture.

    Parameters
    ----------
    survey : Survey
        With as many frames as patterns.
    names : sequence of str
        What the frames are called.
    order_only : bool
        Leave out what does not bear on the order of the frames; what is said of that is the same.
    """
    interchanged = check_interchanged(survey)
    if interchanged:
        return interchanged
    found = []
    if not order_only:
        found += [*check_patterns(survey.patterns), *check_light(survey)]
        found += check_jpeg(survey, names)
    rows = lively_rows(survey)
    if survey.count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return found
    pairs = Pairs.find(survey.patterns)
    how = _by_prediction if pairs is None else _by_pairs(pairs)
    light = None if order_only else not any(each.kind == "jpeg" for each in found)
    return found + how(survey, rows, names, light)


def _by_pairs(pairs: Pairs) -> How:
    """Checks of patterns that come with their inverse."""

    def check(
        survey: Survey, rows: NDArray[np.int64], names: Sequence[str], light: bool | None
    ) -> list[Finding]:
        plain = check_plain_frames(survey, rows, names)
        found, right, doubted = check_pairs(survey, rows, pairs, names)
        if light is None or any(each.kind == "motion" for each in found):
            return [*plain, *found]
        # What does not add up since it is not linear is no change of the light.
        bent = check_response(right, rows, doubted, steady=False) if light else []
        if not bent:
            gains, frames = pair_gains(right, rows, pairs, doubted)
            bent = check_brightness(gains, np.full(len(gains), _PAIR_ERROR), frames, names)
        return [*plain, *found, *bent]

    return check


def _by_prediction(
    survey: Survey, rows: NDArray[np.int64], names: Sequence[str], light: bool | None
) -> list[Finding]:
    """Checks of patterns that have nothing to do with each other."""
    disorder = find_disorder(survey.patterns, survey.tiles(), len(survey.raw), names.__getitem__)
    if disorder is not None and len(disorder.frames) > _FEW * survey.count:
        return [_as_finding(disorder)]
    doubted = np.zeros(survey.count, bool)
    if disorder is not None:
        doubted[list(disorder.frames)] = True
    found = check_plain_frames(survey, rows, names)
    prediction = predict(survey.patterns, survey.samples(rows), doubted=doubted)
    suspects = _suspects(prediction, doubted)
    moved = check_motion(survey, rows, suspects, names)
    if moved:
        return [*found, *moved]
    if (suspects & ~doubted).any():
        # Judged by what the frames say that are not suspected.
        prediction = predict(survey.patterns, survey.samples(rows), doubted=suspects)
    told = prediction.predicted
    if told.sum() < _FEWEST_ROWS:
        return [*found, *([] if disorder is None else [_as_finding(disorder)])]
    prediction = prediction.rows(told)
    wrong = wrong_frames(prediction)
    if disorder is not None and not wrong[list(disorder.frames)].any():
        # Patterns that differ only where the camera does not look.
        doubted[:], disorder = False, None
    if disorder is not None:
        found.append(_as_finding(disorder))
    right = np.flatnonzero(~wrong & ~doubted)
    found += check_content(prediction, wrong & ~doubted, names)
    if light is None:
        return found
    found += check_brightness(*gains(prediction.frames(right)), right, names)
    if light:
        steady = not any(each.kind == "flicker" for each in found)
        found += check_response(survey, rows, suspects | wrong, steady=steady)
    return found


def _suspects(prediction: Prediction, doubted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Frames that may show something else than their pattern, if only a few do, (K,)."""
    told = prediction.predicted
    if told.sum() < _FEWEST_ROWS:
        return doubted
    suspects = doubted | wrong_frames(prediction.rows(told), SUSPECT)
    return suspects if suspects.mean() < _FEW else doubted


def _as_finding(disorder: Disorder) -> Finding:
    return Finding(
        "order",
        disorder.frames,
        disorder.message,
        "put the images in the order of the patterns, or take the capture again, waiting longer "
        "after each change of pattern",
    )
