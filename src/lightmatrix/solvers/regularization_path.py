"""Choosing the regularization by hold-out: solutions along a path, judged on unseen patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.objective import predictions
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class RegularizationPath:
    """Solutions along decreasing regularization, judged on patterns they have not seen.

    Parameters
    ----------
    values : (V,) float64
        Regularization, decreasing.
    errors : (V,) float64
        Root mean square misfit of the samples held out, in units of camera sample; a clipped
        sample misfits only where the prediction stays below it.
    held_out : (H,) int64
        Which patterns were held out.
    best : float
        The value of least error; of values within 1 % of it the largest, which is the cheapest.
    """

    values: NDArray[np.float64]
    errors: NDArray[np.float64]
    held_out: NDArray[np.int64]
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
    """Choose the regularization by hold-out.

    Some patterns are set aside; rows are estimated from the others at several values, each started
    from the solution at the one before; the samples set aside say which is best.

    Parameters
    ----------
    problem : Problem
        Its regularization is the middle of the path.
    factors : sequence of float
        Values relative to it, > 0.
    share : float
        Share of the patterns set aside, in (0, 1).
    rows : int
        Rows used, evenly spread; at least 1.
    solver : ActiveSet, optional
        None: one-sided at a gap of 1e-3.
    seed : int
        Seed of the choice of patterns.

    Returns
    -------
    RegularizationPath

    Raises
    ------
    InputError
        On parameters out of range, or too few patterns to set any aside.
    """
    if not factors or min(factors) <= 0 or not np.isfinite(factors).all():
        raise InputError(f"factors of {list(factors)}", hint="give positive numbers, such as 2 1")
    count = problem.patterns.count
    aside = round(share * count)
    if not (0 < share < 1 and 1 <= aside < count):
        raise InputError(
            f"a share of {share} of {count} patterns held out",
            hint="leave at least one on each side",
        )
    if rows < 1 or problem.rows < 1:
        raise InputError(f"{min(rows, problem.rows)} rows to choose by", hint="use at least 1")
    solver = solver or ActiveSet(tolerance=1e-3)
    problem = problem.take(np.unique(np.linspace(0, problem.rows - 1, rows).astype(np.int64)))
    order = np.random.Generator(np.random.PCG64(seed)).permutation(count)
    held_out, kept = np.sort(order[:aside]), np.sort(order[aside:])
    fit, judge = problem.frames(kept), problem.frames(held_out)
    values = np.sort(np.asarray(factors, np.float64))[::-1] * problem.regularization
    errors = np.empty(len(values))
    start: SparseRows | None = None
    for i, value in enumerate(values):
        result = solver.solve(replace(fit, regularization=float(value)), start=start)
        start = result.rows
        errors[i] = _misfit(judge, result, solver.fidelity)
    best = values[np.flatnonzero(errors <= 1.01 * errors.min())[0]]
    return RegularizationPath(values, errors, held_out, float(best))


def _misfit(problem: Problem, result: Result, fidelity: Fidelity | str) -> float:
    u = predictions(problem, result.coefficients, result.background)
    term, seen = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    weights = np.where(term.counted(seen), seen.weights, 0)
    total = weights.sum()
    squares = weights * term.residual(u, seen) ** 2
    return float(np.sqrt(squares.sum() / total)) if total > 0 else 0.0
