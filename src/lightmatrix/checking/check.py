"""All checks of a capture, one after the other, each knowing what those before it found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.order import Disorder, find_disorder
from lightmatrix.checking.brightness import check_brightness
from lightmatrix.checking.content import SUSPECT, check_content, wrong_frames
from lightmatrix.checking.finding import Finding
from lightmatrix.checking.identity import check_interchanged, check_patterns
from lightmatrix.checking.jpeg import check_jpeg
from lightmatrix.checking.levels import check_light, check_plain_frames
from lightmatrix.checking.local import Prediction, predict
from lightmatrix.checking.motion import check_motion
from lightmatrix.checking.response import check_response
from lightmatrix.checking.rows import lively_rows
from lightmatrix.checking.survey import Survey

# Nothing is told from fewer frames, or fewer camera pixels that can be predicted.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 20
# More odd frames than this share have something in common.
_FEW = 0.25


def check_capture(capture: Capture) -> list[Finding]:
    """Everything that seems wrong with a capture.

    Parameters
    ----------
    capture : Capture
        Its frames are looked at as they were taken, whatever is binned.

    Returns
    -------
    list of Finding
        Empty if nothing seems wrong. What too few frames or a diffuse scene cannot tell is not
        found.

    Raises
    ------
    InputError
        On a frame that cannot be read, or differs from the others in size or type.
    """
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    names = [capture.frames.name(k) for k in range(capture.count)]
    return check_survey(survey, names)


def check_survey(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Everything that seems wrong with what was surveyed of a capture.

    Parameters
    ----------
    survey : Survey
        With as many frames as patterns.
    names : sequence of str
        What the frames are called.
    """
    interchanged = check_interchanged(survey)
    if interchanged:
        return interchanged
    found = [*check_patterns(survey.patterns), *check_light(survey), *check_jpeg(survey, names)]
    rows = lively_rows(survey)
    if survey.count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return found
    disorder = find_disorder(survey.patterns, survey.tiles(), len(survey.raw), names.__getitem__)
    if disorder is not None and len(disorder.frames) > _FEW * survey.count:
        return [*found, _as_finding(disorder)]
    doubted = np.zeros(survey.count, bool)
    if disorder is not None:
        found.append(_as_finding(disorder))
        doubted[list(disorder.frames)] = True
    found += check_plain_frames(survey, rows, names)
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
        return found
    prediction = prediction.rows(told)
    wrong = wrong_frames(prediction)
    right = np.flatnonzero(~wrong & ~doubted)
    flicker = check_brightness(prediction.frames(right), right, names)
    bent = check_response(survey, rows, suspects | wrong, steady=not flicker)
    return [*found, *check_content(prediction, wrong & ~doubted, names), *flicker, *bent]


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
