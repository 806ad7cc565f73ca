"""Checks some rows, solved on likely atoms only, against all atoms."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.estimators.coherent.row_solver import RowSolver, WeightedRows
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.resources.threads import core_threads
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Result

# Rows of an estimate, evenly spread, that are checked against all atoms. Chosen by hand: few enough
# to cost little next to the estimate.
SAMPLED = 256
# A correlation may exceed its bound by this share, which is ten times the relative gap of the rows.
SLACK = 0.01
# Rows whose correlations with all atoms a thread holds in memory together.
_ROWS_TOGETHER = 3


def sampled_rows(start: int, stop: int, count: int) -> NDArray[np.int64]:
    """The rows among start..stop of `count` that are checked."""
    step = max(1, count // SAMPLED)
    index = np.arange(start, stop)
    return index[index % step == step // 2]


def certified_everywhere(
    solver: RowSolver, weighted: WeightedRows, solved: Result, rows: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether no other atom, at the penalty 2 lambda, would enter each of the n `rows`, (n,).

    This is the optimality condition of a row's weighted problem: the correlation of an atom with
    the row's residual does not exceed its penalty.
    """
    limit = 2 * weighted.problem.regularization * (1 + SLACK)
    shown, unseen = _residuals(solver, weighted, solved, rows)
    parts = [(solver.atoms.prepared, shown)]
    if unseen is not None:
        parts.append((solver.unseen.prepared, unseen))

    def none_exceeds(first: int) -> list[bool]:
        some = [(prepared, e[first : first + _ROWS_TOGETHER]) for prepared, e in parts]
        return [
            not (sum(prepared.columns(near) @ e[i] for prepared, e in some) > limit).any()
            # Scores of 16 bits bound the correlations; few may exceed the limit.
            for i, near in enumerate(_core.may_exceed(some, limit))
        ]

    with ThreadPoolExecutor(solver.solver.threads or core_threads()) as pool:
        holds = chain.from_iterable(pool.map(none_exceeds, range(0, len(rows), _ROWS_TOGETHER)))
        return np.fromiter(holds, np.bool_, len(rows))


def _residuals(
    solver: RowSolver, weighted: WeightedRows, solved: Result, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Weighted residuals of some rows, under the patterns shown and under the unseen ones."""
    problem, pseudo = weighted.problem, weighted.pseudo_samples
    count = problem.patterns.count
    coefficients = csr_array(solved.coefficients[rows])
    light: NDArray[Any] = solved.background[rows][:, None] * weighted.background[rows]
    light = light + solved.cells[rows] @ weighted.cells.means
    samples = problem.observed.at(rows).astype(np.float64)
    predicted = _under(solver.atoms, coefficients) + light[:, :count]
    term = Fidelity(solver.solver.fidelity).term
    shown = samples.weights * term.residual(predicted, samples)
    if pseudo is None:
        return shown, None
    unseen = _under(solver.unseen, coefficients) + light[:, count:]
    both = np.concatenate([predicted, unseen], axis=1)
    further = pseudo.weights[rows] * (pseudo.values[rows] - both)
    return shown + further[:, :count], np.ascontiguousarray(further[:, count:])


def _under(atoms: AtomPatterns, rows: csr_array) -> NDArray[np.float64]:
    """The samples of rows of atoms under the patterns, (n, K)."""
    used, place = np.unique(rows.indices, return_inverse=True)
    own = csr_array((rows.data, place, rows.indptr), shape=(rows.shape[0], len(used)))
    return np.asarray(own @ atoms.prepared.columns(used).astype(np.float64))
