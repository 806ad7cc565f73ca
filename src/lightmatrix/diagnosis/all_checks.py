"""All checks of a capture, one after the other; each knows what those before it found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.flicker import brightness_changes, check_flicker
from lightmatrix.diagnosis.frame_order import find_disorder
from lightmatrix.diagnosis.grey_levels import check_grey_levels
from lightmatrix.diagnosis.inverse_pairs import Pairs, check_pairs, pair_gains
from lightmatrix.diagnosis.jpeg import check_jpeg
from lightmatrix.diagnosis.light_levels import check_light_level, check_plain_frames
from lightmatrix.diagnosis.linearity import check_linearity
from lightmatrix.diagnosis.motion import check_motion
from lightmatrix.diagnosis.pattern_faults import check_distinguishable, check_interchanged
from lightmatrix.diagnosis.prediction import FramePrediction, predict
from lightmatrix.diagnosis.relation import check_relation
from lightmatrix.diagnosis.responses.greys_from_windows import show_pictures
from lightmatrix.diagnosis.survey import Survey, high_variance_rows
from lightmatrix.diagnosis.wrong_frames import LIKELY, SUSPECT, check_frames, wrong_frames
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.resources.threads import one_blas_thread, side_by_side

# Nothing is inferred from fewer frames, or from fewer camera pixels that can be predicted.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 20
# If more than a quarter of the frames are odd, the cause is not in single frames.
_MOST_ODD = 0.25
# Gains from inverse pairs are medians over many pixels; they are as exact as cameras are linear.
_PAIR_ERROR = 0.004


def check_capture(capture: Capture, *, order_only: bool = False) -> list[Finding]:
    """Everything that seems wrong with a capture, or only what bears on the order of its frames.

    Frames are looked at as they were taken, whatever is binned. Of a rectangle of the photographs,
    only the light is judged: whether frames are in order, or something moved, shows better in whole
    photographs.
    """
    with one_blas_thread():
        return _check(capture, order_only)


def _check(capture: Capture, order_only: bool) -> list[Finding]:
    whole = capture.whole
    survey = _survey(whole)
    names = [capture.frames.name(k) for k in range(capture.count)]
    findings = check_interchanged(survey)
    if findings:
        return findings
    rows = high_variance_rows(survey)

    def of_light() -> list[Finding]:
        if order_only:
            return []
        seen = survey if whole is capture else _survey(capture)
        found = check_distinguishable(survey.patterns) + check_light_level(seen)
        return found + check_jpeg(survey, names)

    if survey.count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return of_light()
    pairs = Pairs.find(survey.patterns)

    def of_order() -> list[Finding]:
        if pairs is not None:
            return []
        tiles = survey.tiles()
        return find_disorder(survey.patterns, tiles, len(survey.raw), names.__getitem__)

    # The longest first; each of them keeps about one core busy.
    disorder, findings, unrelated = side_by_side(
        [of_order, of_light, lambda: check_relation(survey, names)]
    )
    light = None if order_only else not any(each.kind == "jpeg" for each in findings)
    if pairs is None:
        return findings + _check_by_prediction(survey, rows, names, light, disorder, unrelated)
    return findings + _check_by_pairs(survey, rows, names, light, pairs, unrelated)


def _survey(capture: Capture) -> Survey:
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    patterns = capture.patterns
    grey = patterns.as_bits() is None and not isinstance(patterns, ColourPatterns)
    greys = grey and capture.bin_projector == (1, 1) and not show_pictures(patterns)
    return replace(survey, greys=greys)


# In the two functions below, `disorder` and `unrelated` are what the checks of the order and of the
# relation found. `light` is None if the light is not judged, and False if its linearity is not:
# JPEG rounds dark and bright samples by different steps, which looks like a gamma.


def _check_by_pairs(
    survey: Survey,
    rows: NDArray[np.int64],
    names: Sequence[str],
    light: bool | None,
    pairs: Pairs,
    unrelated: list[Finding],
) -> list[Finding]:
    """Checks of patterns that come with their inverses."""
    if unrelated:
        return unrelated
    findings = check_plain_frames(survey, rows, names)
    of_pairs, corrected, doubted = check_pairs(survey, rows, pairs, names)
    findings += of_pairs
    if light is None or any(each.kind == "motion" for each in of_pairs):
        return findings
    # Sums of pairs that are not linear in light look like changes of the light.
    bent = check_linearity(corrected, doubted, steady=False) if light else []
    if bent:
        return findings + bent
    gains, frames = pair_gains(corrected, rows, pairs, doubted)
    return findings + check_flicker(gains, np.full(len(gains), _PAIR_ERROR), frames, names)


def _check_by_prediction(
    survey: Survey,
    rows: NDArray[np.int64],
    names: Sequence[str],
    light: bool | None,
    disorder: list[Finding],
    unrelated: list[Finding],
) -> list[Finding]:
    """Checks of patterns that have nothing to do with each other."""
    displaced = np.zeros(survey.count, bool)
    for each in disorder:
        displaced[list(each.frames)] = True
    if displaced.mean() > _MOST_ODD:
        return disorder
    if any(each.kind == "order" for each in unrelated):
        return unrelated
    findings = check_plain_frames(survey, rows, names)
    prediction = predict(survey.patterns, survey.samples(rows), doubted=displaced)
    suspects = _suspects(prediction, displaced)
    moved = check_motion(survey, rows, suspects, names)
    if moved:
        return findings + moved
    # Photographs of which half are shifted may seem unrelated to their patterns, too.
    if unrelated:
        return unrelated
    first = prediction
    if (suspects & ~displaced).any():
        # Judged by the frames that are not suspected.
        prediction = predict(survey.patterns, survey.samples(rows), doubted=suspects)
    if prediction.predicted.sum() < _FEWEST_ROWS:
        return findings + disorder
    prediction = prediction.rows(prediction.predicted)
    wrong = wrong_frames(prediction)
    if wrong[displaced].any():
        findings += disorder
    else:
        # The patterns differ only where the camera does not look.
        displaced[:] = False
    # Without a frame, its rows may be explained by other places; then it seems wrong only now.
    both = wrong & wrong_frames(first.rows(first.predicted), LIKELY)
    findings += check_frames(prediction, both & ~displaced, names)
    if light is None:
        return findings
    right = np.flatnonzero(~wrong & ~displaced)
    findings += check_flicker(*brightness_changes(prediction.frames(right)), right, names)
    if light:
        steady = not any(each.kind == "flicker" for each in findings)
        judge_light = check_grey_levels if survey.greys else check_linearity
        findings += judge_light(survey, suspects | wrong, steady=steady)
    return findings


def _suspects(prediction: FramePrediction, displaced: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Frames (K,) that are displaced or may show something else, if only a few do."""
    if prediction.predicted.sum() < _FEWEST_ROWS:
        return displaced
    suspects = displaced | wrong_frames(prediction.rows(prediction.predicted), SUSPECT)
    return suspects if suspects.mean() < _MOST_ODD else displaced
