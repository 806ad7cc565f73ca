"""The regularization: its default, and the choice that predicts held-out patterns best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result, predictions
from lightmatrix.transport.sparse_rows import SparseRows

# The regularization is at least this share of the clip level, for the weak tail of real rows. On
# rendered scenes (128 x 128, 64 to 1,024 patterns) errors rise slowly above it and hardly fall
# below.
TAIL_SHARE = 0.16
# It is also at least this share of the noise's universal threshold. Below it rows fill with noise,
# solving takes ten to a hundred times as long, and the estimate gets no better.
NOISE_SHARE = 0.75


def default_regularization(
    patterns: PatternSet, clip_level: float, noise: float | None = None
) -> float:
    """The paper's lambda in units of camera sample, from what is known of patterns and sensor.

    It is the larger of `TAIL_SHARE` times `clip_level` (or the level that samples reach, if lower)
    and `NOISE_SHARE` times the universal threshold sigma |column| sqrt(2 ln N) (Donoho & Johnstone
    1994; for l1, Chen, Donoho & Saunders 1998), which `noise` sigma makes the correlation of some
    dark pixel reach. |column| is the length of a centred column. None means 0.003 clip levels.
    """
    if not (np.isfinite(clip_level) and clip_level > 0):
        raise InputError(f"the clip level is {clip_level}", hint="use a positive camera sample")
    if noise is not None and not (np.isfinite(noise) and noise >= 0):
        raise InputError(f"the noise is {noise}", hint="use a standard deviation of 0 or more")
    sigma = USUAL_NOISE * clip_level if noise is None else noise
    threshold = sigma * column_length(patterns) * np.sqrt(2 * np.log(max(patterns.pixels, 2)))
    return float(max(TAIL_SHARE * clip_level, NOISE_SHARE * threshold))


def column_length(patterns: PatternSet) -> float:
    """The root mean square length of the columns of P, with the patterns' means subtracted."""
    squares = sum(
        float(np.square(chunk, dtype=np.float64).sum()) / patterns.pixels
        for _, chunk in patterns.chunks()
    )
    return float(np.sqrt(max(squares - float((patterns.means**2).sum()), 0.0)))


@dataclass(frozen=True)
class RegularizationPath:
    """Prediction errors of several regularizations on patterns that were held out."""

    values: NDArray[np.float64]
    # RMS error of the predictions, in camera samples. A clipped sample counts only where the
    # prediction lies below it.
    errors: NDArray[np.float64]
    held_out: NDArray[np.int64]
    # The largest value whose error is within 1 % of the least one: larger values are faster.
    best: float


def regularization_path(
    problem: Problem,
    *,
    factors: Sequence[float] = (4, 2, 1, 0.5),
    share: float = 0.125,
    rows: int = 256,
    solver: ActiveSet | None = None,
    seed: int = 0,
) -> RegularizationPath:
    """Choose among `factors` times the problem's regularization by a `share` of held-out patterns.

    The `rows`, evenly spread, are estimated at each value from the solution at the one before.
    """
    if not factors or min(factors) <= 0 or not np.isfinite(factors).all():
        raise InputError(
            f"the factors are {list(factors)}", hint="give positive numbers, such as 2 1"
        )
    count = problem.patterns.count
    held_count = round(share * count)
    if not (0 < share < 1 and 1 <= held_count < count):
        raise InputError(
            f"a share of {share} of {count} patterns cannot be held out",
            hint="hold out at least one pattern and keep at least one",
        )
    if rows < 1 or problem.rows < 1:
        raise InputError(
            f"there are {min(rows, problem.rows)} rows to choose by", hint="use at least 1"
        )
    solver = solver or ActiveSet(tolerance=1e-3)
    problem = problem.take(np.unique(np.linspace(0, problem.rows - 1, rows).astype(np.int64)))
    order = np.random.Generator(np.random.PCG64(seed)).permutation(count)
    held_out, kept = np.sort(order[:held_count]), np.sort(order[held_count:])
    fit, unseen = problem.frames(kept), problem.frames(held_out)
    values = np.sort(np.asarray(factors, np.float64))[::-1] * problem.regularization
    errors = np.empty(len(values))
    start: SparseRows | None = None
    for i, value in enumerate(values):
        result = solver.solve(replace(fit, regularization=float(value)), start=start)
        start = result.rows
        errors[i] = _prediction_error(unseen, result, solver.fidelity)
    # Prediction errors within 1 % of the least one count as equal to it. Chosen by hand.
    best = values[np.flatnonzero(errors <= 1.01 * errors.min())[0]]
    return RegularizationPath(values, errors, held_out, float(best))


def _prediction_error(problem: Problem, result: Result, fidelity: Fidelity | str) -> float:
    u = predictions(problem, result.coefficients, result.background)
    term, observed = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    weights = np.where(term.used(observed), observed.weights, 0)
    total = weights.sum()
    squares = weights * term.residual(u, observed) ** 2
    return float(np.sqrt(squares.sum() / total)) if total > 0 else 0.0
