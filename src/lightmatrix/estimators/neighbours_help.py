"""Whether camera pixels should learn from their neighbours: photographs held out decide.

Behind a diffuser, or where a camera pixel's neighbour is another object, neighbours mislead. Then
the estimate row by row predicts photographs that it has not seen better than the coherent one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.camera_window import window_of_light
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_errors import HeldOut, squared_misfit
from lightmatrix.estimators.coherent.schedule import is_large
from lightmatrix.estimators.plain import PlainEstimator

# Both are tried on about this many camera samples around the middle of the light. Chosen by hand: a
# square of 24 x 24 takes a thirtieth of the time of all 128 x 128 pixels.
_TRIED = 576
# The estimate row by row must leave at most a tenth of the variance of photographs that it has not
# seen. With few patterns, or with light that does not follow them, it leaves more. Then the
# coherent estimate is not even tried, and stays, since it states its error.
_LEFT = 0.1
# Its misfit must be below half of the coherent one's. On nine synthetic scenes under six kinds of
# patterns the shares were 0.01 to 0.47 on independent speckle, where it errs less, and at least
# 0.54 elsewhere.
_BETTER = 0.5


def can_be_tried(capture: Capture) -> bool:
    """Whether all camera pixels of a part of the frame can search for light; not if it is large."""
    return not is_large(capture.rows, capture.patterns.pixels)


def neighbours_help(
    capture: Capture, coherent: CoherentEstimator, row_by_row: PlainEstimator
) -> bool:
    """Whether the coherent estimate predicts frames held out as well as that row by row, or better.

    True without a test if no frame can be held out, or if the frames are so large that only some of
    their camera pixels could search for light.
    """
    held = HeldOut.choose(capture.patterns)
    if not len(held.judged) or not can_be_tried(capture):
        return True
    others = np.setdiff1d(np.arange(capture.count), held.frames)
    region = window_of_light(capture, held.judged, _TRIED)
    tried = capture if region is None else capture.window(*region)
    samples, seen = tried.samples(), tried.select(others)
    shown = capture.patterns.subset(held.judged)
    patterns = shown.rows(0, shown.count).reshape(-1, *capture.projector_shape)

    def misfit(estimator: CoherentEstimator | PlainEstimator | None) -> float:
        predicted = np.zeros((tried.rows, shown.count), np.float32)
        if estimator is not None:
            quick = replace(estimator, judged=False)
            predicted = quick.estimate(seen).relight(patterns).reshape(shown.count, -1).T
        squares = squared_misfit(samples, predicted, held.judged)
        known = squares[np.isfinite(squares)]
        return float(known.mean()) if len(known) else 0.0

    alone = misfit(row_by_row)
    # Without an estimate the misfit is the variance of the photographs.
    return alone > _LEFT * misfit(None) or alone >= _BETTER * misfit(coherent)
