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
    if disorder is not None and len(disorder.frames) > 0.25 * survey.count:
        return [*found, _as_finding(disorder)]
    doubted = np.zeros(survey.count, bool)
    if disorder is not None:
        found.append(_as_finding(disorder))
        doubted[list(disorder.frames)] = True
    moved = check_motion(survey, rows, names)
    if moved:
        return [*found, *moved]
    found += check_plain_frames(survey, rows, names)
    prediction = predict(survey.patterns, survey.samples(rows), doubted=doubted)
    told = prediction.predicted
    if told.sum() < _FEWEST_ROWS:
        return found
    bent = check_response(survey, rows[told], tuple(place[told] for place in prediction.places))
    if bent:
        return [*found, *bent]
    return [*found, *_check_frames(survey, rows, prediction, doubted, names)]


def _check_frames(
    survey: Survey,
    rows: NDArray[np.int64],
    prediction: Prediction,
    doubted: NDArray[np.bool_],
    names: Sequence[str],
) -> list[Finding]:
    """What single frames show, and how bright they are.

    Parameters
    ----------
    doubted : (K,) bool
        Frames that something was said of already.
    """
    suspects = doubted | wrong_frames(prediction.rows(prediction.predicted), SUSPECT)
    if suspects.mean() < 0.5 and (suspects & ~doubted).any():
        # Judged by what the frames say that are not suspected.
        prediction = predict(survey.patterns, survey.samples(rows), doubted=suspects)
    prediction = prediction.rows(prediction.predicted)
    if len(prediction.miss) < _FEWEST_ROWS:
        return []
    wrong = wrong_frames(prediction)
    found = check_content(prediction, wrong & ~doubted, names)
    right = np.flatnonzero(~wrong & ~doubted)
    return found + check_brightness(prediction.frames(right), right, names)


def _as_finding(disorder: Disorder) -> Finding:
    return Finding(
        "order",
        disorder.frames,
        disorder.message,
        "put the images in the order of the patterns, or take the capture again, waiting longer "
        "after each change of pattern",
    )
