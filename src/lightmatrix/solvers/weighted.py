"""Rows solved on given pixels only, each with a penalty of its own, to a certified gap."""

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
    """Pixels that each of M rows may use, as the parts of a CSR matrix.

    Parameters
    ----------
    indptr : (M + 1,) int64
        Where each row's entries begin.
    indices : (E,) int32
        Projector pixels, ascending within a row.
    data : (E,) float32
        Penalties relative to the problem's regularization, > 0.
    """

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    data: NDArray[np.float32]


@dataclass(frozen=True)
class Cells:
    """Coarse columns that all rows share: the means of the patterns over the cells of a grid.

    Parameters
    ----------
    means : (C, K) float32
        Mean of each pattern over each cell, in [0, 1]; with an expectation (C, K + E), those of
        its unseen patterns last.
    penalties : (C,) float32
        Penalties relative to the problem's regularization, > 0.
    """

    means: NDArray[np.float32]
    penalties: NDArray[np.float32]

    @classmethod
    def none(cls, patterns: PatternSet, unseen: PatternSet | None = None) -> Cells:
        """No cells."""
        count = patterns.count + (0 if unseen is None else unseen.count)
        return cls(np.zeros((0, count), np.float32), np.zeros(0, np.float32))


@dataclass(frozen=True)
class Expectation:
    """What the samples of M rows are expected to be: further samples, of little weight.

    Parameters
    ----------
    unseen : PatternSet
        E patterns that were not shown, of as many pixels as the K that were.
    values : (M, K + E) float32
        Expected samples under the patterns shown (beside those that were taken, which may clip),
        then under the unseen ones.
    weights : (M, K + E) float32
        Their weights in the data term; 0 where nothing is expected.
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
    expected: Expectation | None = None,
    background: NDArray[np.float32] | None = None,
    start: SparseRows | None = None,
    progress: Progress | None = None,
) -> Result:
    """Solve each row on its candidates and the cells.

    ::

        min over x, g, b >= 0 of  lambda (sum_j v_j x_j + sum_l w_l g_l)
                                  + sum_k w_k f_k(a_k . x + m_k . g + b mean_k)

    The weighted l1 norm of Candes, Wakin & Boyd 2008, whose weights come from elsewhere (see
    `lightmatrix.estimators.coherent`).

    Parameters
    ----------
    problem : Problem
        M rows; light is not negative.
    candidates : Candidates
        Pixels of each row and their weights v.
    cells : Cells
        Coarse columns and their weights w.
    solver : ActiveSet
        Fidelity, tolerance, limit of passes, threads.
    expected : Expectation, optional
        Further samples that were not taken.
    background : (M, K) or, with an expectation, (M, K + E) float32, optional
        What each row's background gives under the patterns, in [0, 1], in place of their means.
    start : SparseRows, optional
        Such as the rows of an earlier result. Pixels that are no candidates are left out, and
        cells unless there are as many.
    progress : callable, optional
        Called with (finished, all) rows.

    Returns
    -------
    Result
        Its gap is that of the weighted problem on the candidates and cells.

    Raises
    ------
    InputError
        If the parts do not fit the problem.
    """
    if not problem.nonnegative:
        raise InputError(
            "weights from neighbouring rows need light that is not negative",
            hint="leave out --signed, or estimate row by row (--no-coherent)",
        )
    if len(candidates.indptr) != problem.rows + 1:
        raise InputError(
            f"candidates of {len(candidates.indptr) - 1} rows for a problem of {problem.rows}"
        )
    check_start(problem, start)
    solved, coefficients = _core.solve_weighted(
        prepared(problem),
        problem.samples,
        solver.settings(problem),
        candidates,
        cells=cells,
        expected=None if expected is None else (expected.unseen.prepared, expected),
        background=background,
        start=start,
        progress=progress,
    )
    return as_result(solved, problem, coefficients.astype(np.float32))
