"""The choice of the estimator that suits a capture."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.estimators.automatic_regularization import held_out_path
from lightmatrix.estimators.base import Estimator
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.neighbours_help import can_be_tried, neighbours_help
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.resource_estimate import ResourceEstimate, estimate_resources
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.resources.threads import one_blas_thread
from lightmatrix.solvers import ActiveSet

# A capture of at most so many raw levels is checked within a second or two: 512 x 512 pixels in 64
# frames. Chosen by hand.
_BRIEFLY_CHECKED = 1 << 24


def choose_estimator(
    capture: Capture,
    settings: EstimateSettings | None = None,
    resources: ResourceEstimate | None = None,
) -> Estimator:
    """Choose the estimator that suits a capture.

    The regularization "path" solves some rows for it. Where the settings leave open whether camera
    pixels learn from their neighbours, a part of the camera is estimated both ways without some
    frames. If the estimate row by row predicts these clearly better, it is chosen.

    Parameters
    ----------
    capture : Capture
        What is estimated from.
    settings : EstimateSettings, optional
        How it is estimated. None: the default settings.
    resources : ResourceEstimate, optional
        What `estimate_resources` says of this estimate, if it is known already.

    Returns
    -------
    CoherentEstimator, PlainEstimator or MultiScaleEstimator

    Raises
    ------
    InputError
        If there are too few patterns or rows for a path of regularizations.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> type(lm.choose_estimator(capture)).__name__
    'CoherentEstimator'
    >>> type(lm.choose_estimator(capture, lm.EstimateSettings(solver="romp"))).__name__
    'PlainEstimator'
    """
    settings = settings or EstimateSettings()
    solver, nonnegative = settings.row_solver, not settings.signed
    regularization = None
    if settings.regularization == "path":
        regularization = held_out_path(capture).best
    elif not isinstance(settings.regularization, str):
        regularization = float(settings.regularization)
    if settings.multi_scale:
        return MultiScaleEstimator(solver, regularization, nonnegative, settings.background)
    tile_rows = settings.tile_rows
    if settings.memory is not None:
        tile_rows = (resources or estimate_resources(capture, settings)).tile_rows
    row_by_row = PlainEstimator(solver, regularization, nonnegative, settings.background, tile_rows)
    if not (settings.is_coherent(capture) and isinstance(solver, ActiveSet)):
        return row_by_row
    coherent = CoherentEstimator(
        regularization, fidelity=solver.fidelity, max_passes=solver.max_passes, tile_rows=tile_rows
    )
    if settings.coherent or neighbours_help(capture, coherent, row_by_row):
        return coherent
    return row_by_row


def check_and_choose(
    check: Callable[[], list[Finding]],
    capture: Capture,
    settings: EstimateSettings,
    resources: ResourceEstimate | None = None,
) -> tuple[Estimator, list[Finding]]:
    """Choose the estimator that suits a capture, while a thread checks the frames.

    A check keeps one core busy, and so does much of the choice. Where no estimate is tried, and
    where a check takes long, so that Ctrl-C would wait for it, the check comes first.

    Parameters
    ----------
    check : callable
        Checks the frames, and may refuse them; its errors come before those of the choice.
    capture : Capture
        What is estimated from.
    settings : EstimateSettings
        How it is estimated.
    resources : ResourceEstimate, optional
        What `estimate_resources` says of this estimate, if it is known already.

    Returns
    -------
    CoherentEstimator, PlainEstimator or MultiScaleEstimator
        The result of `choose_estimator`.
    list of Finding
        The result of the check.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> settings = lm.EstimateSettings()
    >>> estimator, found = lm.check_and_choose(lambda: lm.check(capture), capture, settings)
    >>> type(estimator).__name__, found
    ('CoherentEstimator', [])
    """
    undecided = settings.coherent is None and settings.is_coherent(capture)
    levels = math.prod(capture.whole.frames.shape) * capture.count
    if not (undecided and can_be_tried(capture)) or levels > _BRIEFLY_CHECKED:
        findings = check()
        return choose_estimator(capture, settings, resources), findings
    # Results must not depend on which thread is the first to limit those of matrix products.
    with one_blas_thread(), ThreadPoolExecutor(1) as pool:
        checked = pool.submit(check)
        try:
            estimator = choose_estimator(capture, settings, resources)
        except Exception:
            checked.result()
            raise
        return estimator, checked.result()
