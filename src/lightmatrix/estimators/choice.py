"""The choice of the estimator that suits a capture.

Where the settings leave it open whether camera pixels learn from their neighbours, photographs held
out decide. Behind a diffuser, or where a camera pixel's neighbour is another object, neighbours
mislead. Then the estimate row by row predicts photographs that it has not seen better than the
coherent one.
"""

from dataclasses import replace

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.base import Estimator
from lightmatrix.estimators.camera_window import window_of_light
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_errors import HeldOut, squared_misfit
from lightmatrix.estimators.coherent.schedule import is_large
from lightmatrix.estimators.direct import DirectEstimator
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.resource_estimate import ResourceEstimate, estimate_resources
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.solvers import ActiveSet

# Both ways are tried on about this many camera samples around the middle of the light: a square of
# 24 x 24 takes a thirtieth of the time of all 128 x 128 pixels.
_TRIED = 576


def choose_estimator(
    capture: Capture,
    settings: EstimateSettings | None = None,
    resources: ResourceEstimate | None = None,
) -> Estimator:
    """Choose the estimator that suits a capture.

    Where the settings leave open whether camera pixels learn from their neighbours, a part of the
    camera is estimated both ways without some frames. If the estimate row by row predicts these
    clearly better, it is chosen. `resources` is the result of `estimate_resources`, if it is known
    already.
    """
    settings = settings or EstimateSettings()
    resources = resources or estimate_resources(capture, settings)
    solver, nonnegative = settings.row_solver, not settings.signed
    regularization = None
    if not isinstance(settings.regularization, str):
        regularization = float(settings.regularization)
    if settings.multi_scale:
        return MultiScaleEstimator(solver, regularization, nonnegative, settings.background)
    tile_rows = settings.tile_rows if settings.memory is None else resources.tile_rows
    may_be_direct = isinstance(solver, ActiveSet) and settings.may_be_direct
    if may_be_direct and capture.patterns.inverted is not None:
        return DirectEstimator(solver, tile_rows=tile_rows)
    row_by_row = PlainEstimator(solver, regularization, nonnegative, settings.background, tile_rows)
    if not (resources.coherent and isinstance(solver, ActiveSet)):
        return row_by_row
    coherent = CoherentEstimator(
        regularization, fidelity=solver.fidelity, max_passes=solver.max_passes, tile_rows=tile_rows
    )
    if settings.coherent or neighbours_help(capture, coherent, row_by_row):
        return coherent
    return row_by_row


def neighbours_help(
    capture: Capture, coherent: CoherentEstimator, row_by_row: PlainEstimator
) -> bool:
    """Whether the coherent estimate predicts frames held out as well as that row by row, or better.

    True without a test if no frame can be held out, or if the frames are so large that only some of
    their camera pixels could search for light.
    """
    held = HeldOut.choose(capture.patterns)
    if not len(held.judged) or is_large(capture.rows, capture.patterns.pixels):
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
    # The estimate row by row must leave at most a tenth of the variance of these photographs, which
    # is the misfit without an estimate. With few patterns, or with light that does not follow them,
    # it leaves more. Then the coherent estimate is not even tried, and stays, since it states its
    # error. Else the misfit row by row must be below half of the coherent one's. On nine synthetic
    # scenes under six kinds of patterns the shares were 0.01 to 0.47 on independent speckle, where
    # it errs less, and at least 0.54 elsewhere.
    return alone > 0.1 * misfit(None) or alone >= 0.5 * misfit(coherent)
