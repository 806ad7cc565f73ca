"""The weighted problem: rows on candidate pixels, each with a penalty of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.active_set import (
    ActiveSet,
    as_result,
    check_start,
    prepared,
)
from lightmatrix.solvers.loop import Progress
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class Candidates:
    """The ascending pixels that each of M rows may use: the parts of a CSR matrix of penalties.

    Penalties are relative to the problem's regularization, > 0.
    """

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    data: NDArray[np.float32]


@dataclass(frozen=True)
class Cells:
    """Columns that all rows share: the patterns' means over C cells, (C, K) or (C, K + E).

    Penalties (C,) are relative to the problem's regularization, > 0. E counts unseen patterns.
    """

    means: NDArray[np.float32]
    penalties: NDArray[np.float32]

    @classmethod
    def none(cls, patterns: PatternSet, unseen: PatternSet | None = None) -> Cells:
        """A grid without cells."""
        count = patterns.count + (0 if unseen is None else unseen.count)
        return cls(np.zeros((0, count), np.float32), np.zeros(0, np.float32))


@dataclass(frozen=True)
class PseudoSamples:
    """Expected samples of M rows, which count as additional samples of little weight.

    `values` and `weights`, (M, K + E), are under the K patterns shown and the E unseen ones. A
    weight of 0 omits a sample.
    """

    unseen: PatternSet
    values: NDArray[np.float32]
    weights: NDArray[np.float32]


def solve_weighted(
    problem: Problem,
    candidates: Candidates,
    cells: Cells,
    solver: ActiveSet,
    *,
    pseudo_samples: PseudoSamples | None = None,
    background: NDArray[np.float32] | None = None,
    start: SparseRows | None = None,
    progress: Progress | None = None,
) -> Result:
    """Solve each row on its candidates (penalties v) and the cells (penalties w).

    ::

        min over x, g, b >= 0 of  lambda (sum_j v_j x_j + sum_l w_l g_l)
                                  + sum_k w_k f_k(a_k . x + m_k . g + b mean_k)

    This is the weighted l1 norm of Candes, Wakin & Boyd 2008 with weights from neighbouring rows
    (see `lightmatrix.estimators.coherent`). `background`, (M, K) or (M, K + E) in [0, 1], replaces
    the patterns' means by a column for each row. `start` may hold the rows of an earlier result:
    pixels that are no candidates are ignored, and so are its cells if their number differs. The gap
    of the result is that of the weighted problem on candidates and cells.
    """
    if not problem.nonnegative:
        raise InputError(
            "penalties from neighbouring rows need light that is not negative",
            hint="omit --signed, or estimate row by row (--no-coherent)",
        )
    if len(candidates.indptr) != problem.rows + 1:
        raise InputError(
            f"there are candidates for {len(candidates.indptr) - 1} rows, not {problem.rows}"
        )
    check_start(problem, start)
    pseudo = None
    if pseudo_samples is not None:
        pseudo = (pseudo_samples.unseen.prepared, pseudo_samples)
    solved, coefficients = _core.solve_weighted(
        prepared(problem),
        problem.samples,
        solver.settings(problem),
        candidates,
        cells=cells,
        expected=pseudo,
        background=background,
        start=start,
        progress=progress,
    )
    return as_result(solved, problem, coefficients.astype(np.float32))
