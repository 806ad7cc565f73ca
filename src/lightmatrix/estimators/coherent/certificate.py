"""Whether rows that looked at likely atoms only would have found others, had they looked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.solving import Solving, Weighing
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Result

# So many rows of an estimate, evenly spread, are held against all atoms.
SAMPLED = 256
# A correlation may exceed its bound by this share, like a row's gap.
SLACK = 0.01
# Rows whose correlations with all atoms are in memory together.
_TOGETHER = 4


def sampled(start: int, stop: int, count: int) -> NDArray[np.int64]:
    """Those of the rows start..stop of `count` that are held against all atoms."""
    step = max(1, count // SAMPLED)
    index = np.arange(start, stop)
    return index[index % step == step // 2]


def holds_everywhere(
    solving: Solving, weighing: Weighing, solved: Result, rows: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether no atom would enter a row, even at the penalty of atoms that no neighbour holds.

    The optimality condition of each row's weighted problem, with the penalty 2 lambda on every
    atom that was left out: no correlation of an atom with the row's residual exceeds it.

    Parameters
    ----------
    solving : Solving
    weighing : Weighing
        The problem of some rows, (m, ...).
    solved : Result
        Its solution.
    rows : (n,) int
        Which of the m.

    Returns
    -------
    (n,) bool
    """
    limit = 2 * weighing.problem.regularization * (1 + SLACK)
    shown, unseen = _residuals(solving, weighing, solved, rows)
    result = np.zeros(len(rows), np.bool_)
    for first in range(0, len(rows), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        upper = _upper(solving.atoms, shown[part])
        if unseen is not None:
            upper += _upper(solving.unseen, unseen[part])
        for i, bounds in enumerate(upper, start=first):
            near = np.flatnonzero(bounds > limit)
            exact: NDArray[Any] = solving.atoms.prepared.columns(near) @ shown[i]
            if unseen is not None:
                exact = exact + solving.unseen.prepared.columns(near) @ unseen[i]
            result[i] = not (exact > limit).any()
    return result


def _residuals(
    solving: Solving, weighing: Weighing, solved: Result, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Residuals of some rows times their weights, under the patterns shown and the unseen ones."""
    problem, expected = weighing.problem, weighing.expected
    count = problem.patterns.count
    found = csr_array(solved.coefficients[rows])
    light: NDArray[Any] = solved.background[rows][:, None] * weighing.background[rows]
    light = light + solved.cells[rows] @ weighing.cells.means
    seen = problem.observed.at(rows).astype(np.float64)
    predicted = _under(solving.atoms, found) + light[:, :count]
    term = Fidelity(solving.solver.fidelity).term
    shown = seen.weights * term.residual(predicted, seen)
    if expected is None:
        return shown, None
    both = np.concatenate([predicted, _under(solving.unseen, found) + light[:, count:]], axis=1)
    further = expected.weights[rows] * (expected.values[rows] - both)
    return shown + further[:, :count], np.ascontiguousarray(further[:, count:])


def _under(atoms: AtomPatterns, rows: csr_array) -> NDArray[np.float64]:
    """What rows of atoms give under the patterns, (n, K)."""
    used, place = np.unique(rows.indices, return_inverse=True)
    own = csr_array((rows.data, place, rows.indptr), shape=(rows.shape[0], len(used)))
    return np.asarray(own @ atoms.prepared.columns(used).astype(np.float64))


def _upper(atoms: AtomPatterns, e: NDArray[np.float64]) -> NDArray[np.float32]:
    """Upper bounds of the correlations of all atoms with each of the rows, (n, S N)."""
    scores, bounds = atoms.prepared.scores(np.ascontiguousarray(e))
    unit, offset, up, _ = bounds.reshape(-1, 4, 1).transpose(1, 0, 2)
    # One unit in a million more than single precision may lose of it.
    upper = scores * unit.astype(np.float32) + (unit * (offset + up)).astype(np.float32)
    return np.asarray(upper + np.abs(upper) * np.float32(1e-6), np.float32)
