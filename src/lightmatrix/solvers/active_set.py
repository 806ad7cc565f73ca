"""The active-set solver in the compiled core, which solves every row to a certified duality gap.

`ActiveSet` solves rows on all pixels, `solve_weighted` on candidate pixels, each with a penalty of
its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.defaults import PASSES
from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.progress import Progress
from lightmatrix.ranges import as_float, check_at_least_one
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result, Status, solved_rows
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class ActiveSet:
    """Active-set solver for the convex fidelities. Every row comes with its duality gap.

    ::

        min over x >= 0, b >= 0 of  lambda sum x + sum_k w_k f_k(a_k . x + b m_k)

    A row alternates between a solve on few pixels and a pass over all pixels, which finds the
    pixels that violate their optimality condition most, and a dual value (see
    `docs/fast-solver.md`). It stops when the relative gap (P - D) / max(P, 1e-6 ||y||^2 / 2), in
    float64, is at most `tolerance`. A clipped sample's value is a lower bound, so clip levels and
    exposures may differ from sample to sample. Rows do not depend on each other, so results depend
    neither on the number of threads nor on tiles.

    Parameters
    ----------
    fidelity : Fidelity
        one-sided, rejection or linear. `clipped` is not convex and has no gap.
    tolerance : float
        Relative duality gap, in (0, 1).
    max_passes : int
        Limit of passes over all pixels, at least 1. A row that reaches it is returned with the gap
        that it has.
    threads : int or None
        None: one per core.

    Raises
    ------
    SolverError
        For the fidelity `clipped`.
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32)).bin(camera=16)
    >>> problem = lm.Problem(capture.patterns, capture.samples(), regularization=0.1)
    >>> lm.solve(problem, lm.ActiveSet()).coefficients.shape
    (16, 4096)
    """

    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    tolerance: float = 1e-4
    max_passes: int = PASSES
    threads: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", Fidelity(self.fidelity))
        if not Fidelity(self.fidelity).convex:
            raise SolverError(
                f"the active-set solver cannot use the fidelity {self.fidelity}: it is not convex, "
                "so no row could be certified",
                hint="use one-sided, or the solver saturation-admm",
            )
        if not 0 < as_float(self.tolerance) < 1:
            hint = "use a relative gap such as 1e-4"
            raise InputError(f"a tolerance of {self.tolerance}", hint=hint)
        check_at_least_one(max_passes=self.max_passes, threads=self.threads)

    def solve(self, problem: Problem, progress: Progress | None = None) -> Result:
        """Solve all rows; `progress` is called with (finished, all) rows.

        The coefficients are float64.
        """
        solved = prepared(problem).solve(problem.samples, self.settings(problem), progress=progress)
        return as_result(solved, problem)

    def settings(self, problem: Problem) -> _core.Settings:
        """The settings for the core."""
        return _core.Settings(
            regularization=float(problem.regularization),
            fidelity=Fidelity(self.fidelity).term.name, nonnegative=problem.nonnegative,
            background=problem.background, tolerance=self.tolerance, max_passes=self.max_passes,
            threads=self.threads,
        )  # fmt: skip

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: samples twice, 512 entries, a share of the scores of active rows."""
        return 24 * patterns + pixels // 8 + 16 * 512


def prepared(problem: Problem) -> _core.PreparedPatterns:
    """The problem's patterns and background column, prepared for the core."""
    if problem.background_column is None:
        return problem.patterns.prepared
    return problem.patterns.prepare(problem.background_column)


def as_result(
    solved: _core.Solved, problem: Problem, cells: NDArray[np.float32] | None = None
) -> Result:
    """The core's solution as a `Result`, with the coefficients of a weighted problem's cells."""
    shape = (problem.rows, problem.patterns.pixels)
    narrow = solved.indptr[-1] <= np.iinfo(np.int32).max
    indptr = solved.indptr.astype(np.int32) if narrow else solved.indptr
    background = solved.background
    rows = solved_rows(
        csr_array((solved.values, solved.indices, indptr), shape=shape),
        background if cells is None else np.column_stack([background, cells]),
        iterations=solved.passes, converged=solved.converged, gap=solved.gap,
        objective=solved.objective,
    )  # fmt: skip
    return Result(rows, Status.CONVERGED if solved.converged.all() else Status.ITERATION_LIMIT)


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
    def none(cls, patterns: PatternSet, unseen: PatternSet | None = None) -> "Cells":
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
    problem: Problem, candidates: Candidates, cells: Cells, solver: ActiveSet, *,
    pseudo_samples: PseudoSamples | None = None, background: NDArray[np.float32] | None = None,
    start: SparseRows | None = None, progress: Progress | None = None,
) -> Result:  # fmt: skip
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
            hint="use signed=False, or estimate row by row (coherent=False)",
        )
    if len(candidates.indptr) != problem.rows + 1:
        raise InputError(
            f"there are candidates for {len(candidates.indptr) - 1} rows, not {problem.rows}"
        )
    shape = (problem.rows, problem.patterns.pixels)
    if start is not None and start.coefficients.shape != shape:
        raise InputError(
            f"the start has shape {start.coefficients.shape}, but the problem has {shape}"
        )
    pseudo = None
    if pseudo_samples is not None:
        pseudo = (pseudo_samples.unseen.prepared, pseudo_samples)
    solved, coefficients = _core.solve_weighted(
        prepared(problem), problem.samples, solver.settings(problem), candidates, cells=cells,
        expected=pseudo, background=background, start=start, progress=progress,
    )  # fmt: skip
    return as_result(solved, problem, coefficients.astype(np.float32))
