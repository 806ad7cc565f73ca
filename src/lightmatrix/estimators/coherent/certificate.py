"""Whether rows that looked at likely atoms only would have found others, had they looked."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.estimators.coherent.solving import Solving, Weighing
from lightmatrix.estimators.needs import usual_threads
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Result

# So many rows of an estimate, evenly spread, are held against all atoms.
SAMPLED = 256
# A correlation may exceed its bound by this share, like a row's gap.
SLACK = 0.01
# Rows whose correlations with all atoms a thread has in memory together.
_TOGETHER = 4
# No more than this, in units of a score, is lost where 16-bit scores are added in single precision.
_ROUNDING = 2**-7


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
    parts = [(solving.atoms.prepared, shown)]
    if unseen is not None:
        parts.append((solving.unseen.prepared, unseen))

    def none_beyond(first: int) -> list[bool]:
        some = [(prepared, e[first : first + _TOGETHER]) for prepared, e in parts]
        return [
            not (sum(prepared.columns(near) @ e[i] for prepared, e in some) > limit).any()
            for i, near in enumerate(_perhaps_beyond(some, limit))
        ]

    with ThreadPoolExecutor(solving.solver.threads or usual_threads()) as pool:
        found = chain.from_iterable(pool.map(none_beyond, range(0, len(rows), _TOGETHER)))
        return np.fromiter(found, np.bool_, len(rows))


def _perhaps_beyond(
    parts: list[tuple[_core.PreparedPatterns, NDArray[np.float64]]], limit: float
) -> Iterator[NDArray[np.int64]]:
    """Of each row the atoms whose correlations, summed over the parts, may exceed a limit."""
    scored = []
    for prepared, e in parts:
        scores, bounds = prepared.scores(np.ascontiguousarray(e))
        unit, offset, up, _ = bounds.reshape(-1, 4).T
        scored.append((scores, unit, unit * (offset + up + _ROUNDING)))
    for i in range(len(scored[0][0])):
        upper = sum(scores[i] * np.float32(unit[i]) for scores, unit, _ in scored)
        yield np.flatnonzero(upper > limit - sum(most[i] for _, _, most in scored))


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
