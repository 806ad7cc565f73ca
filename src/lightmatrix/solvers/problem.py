"""The input and the output of all solvers, `Problem` and `Result`, for many rows at once.

Objectives are computed in float64 from their definitions.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import ShortRepr
from lightmatrix.solvers.fidelity import Fidelity, Observed
from lightmatrix.transport.sparse_rows import SparseRows

Floats = NDArray[np.float64]


class Status(StrEnum):
    """Why a row stopped, and the remedy."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached: raise the limit or the tolerance"
    NOT_FINITE = "left the finite numbers: check the samples, raise the regularization"


@dataclass(frozen=True, repr=False)
class Problem(ShortRepr):
    """Estimate M rows of the light transport matrix from K samples each.

    For each row: min_{x, b} regularization * ||x||_1 + sum_k w_k f_k(a_k . x + b m_k), with a_k
    pattern k, m the column of the background and f_k the solver's fidelity. This is the paper's
    Eq. 2 and 6, multiplied by lambda. With ``nonnegative``, x >= 0 and b >= 0; without
    ``background``, b = 0.

    Parameters
    ----------
    patterns : PatternSet
        K patterns over N projector pixels.
    samples : Samples
        M camera samples under K patterns: linear, black subtracted; where clipped, a lower bound.
        The `clipped` fidelity also uses the clip level of unclipped samples.
    regularization : float
        The paper's lambda, in units of camera sample; > 0.
    nonnegative : bool
        Whether light is not negative. Off only to reproduce the paper.
    background : bool
        Whether the row has an unpenalised coefficient b of the background (diffuse light).
    background_column : (K,) float, optional
        m: the light of the whole projector under each pattern. None: the means of the patterns.
        Patterns over a part of the projector need it, since diffuse light comes from all of it.

    Raises
    ------
    InputError
        If shapes do not match, samples are not finite, or values are out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> lm.Problem(capture.patterns, capture.samples(0, 5), regularization=0.01).rows
    5
    """

    patterns: PatternSet
    samples: Samples
    regularization: float
    nonnegative: bool = True
    background: bool = True
    background_column: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        self.samples.check(self.patterns.count)
        check_regularization(self.regularization)
        column = self.background_column
        if column is not None and (
            column.shape != (self.patterns.count,) or not np.isfinite(column).all()
        ):
            raise InputError(
                f"the background column has shape {column.shape}, not ({self.patterns.count},)",
                hint="give one finite number for each pattern, such as its mean",
            )

    @property
    def rows(self) -> int:
        """Number of camera samples M."""
        return self.samples.count

    @property
    def column(self) -> Floats:
        """m, (K,) float64: the column of the background."""
        if self.background_column is None:
            return self.patterns.means
        return np.asarray(self.background_column, np.float64)

    def take(self, rows: NDArray[np.integer]) -> "Problem":
        """The problem of some of the rows."""
        return replace(self, samples=self.samples.rows(rows))

    @cached_property
    def observed(self) -> Observed:
        """The samples for the fidelities, in their own precision."""
        samples = self.samples
        return Observed(
            samples.values, samples.clipped, samples.clip_levels_of_all(), samples.weights_of_all()
        )


def check_regularization(value: float) -> None:
    """Refuse a regularization that is not a positive number."""
    if not (np.isfinite(value) and value > 0):
        hint = "use a positive number in units of camera sample, such as 0.3"
        raise InputError(f"regularization is {value}", hint=hint)


@dataclass(frozen=True, repr=False)
class Result(ShortRepr):
    """The solution of a problem.

    Parameters
    ----------
    rows : SparseRows
        The rows, with iterations, convergence, gap and objective as diagnostics.
    status : Status
        The worst status of all rows.

    Examples
    --------
    See `solve`.

    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> problem = lm.Problem(capture.patterns, capture.samples(0, 3), regularization=0.1)
    >>> lm.solve(problem, lm.ActiveSet()).converged
    array([ True,  True,  True])
    """

    rows: SparseRows
    status: Status

    @property
    def coefficients(self) -> csr_array:
        """The sparse rows x, (M, N), in units of camera sample per unit of projector pixel."""
        return self.rows.coefficients

    @property
    def background(self) -> NDArray[Any]:
        """The coefficient b of the background, (M,); 0 if the problem has none."""
        return self.rows.background[:, 0]

    @property
    def cells(self) -> NDArray[Any]:
        """Coefficients of a weighted problem's coarse cells, (M, C); other problems have none."""
        return self.rows.background[:, 1:]

    @property
    def iterations(self) -> NDArray[np.int32]:
        """Iterations (ADMM), rounds (ROMP) or passes (active set) of each row, (M,)."""
        return self.rows.diagnostics["iterations"]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether each row converged, (M,)."""
        return self.rows.diagnostics["converged"]

    @property
    def gap(self) -> Floats:
        """Relative duality gap of the active set, (M,); NaN of other solvers."""
        return self.rows.diagnostics["gap"]

    @property
    def objective(self) -> Floats:
        """The objective with the solver's fidelity, (M,)."""
        return self.rows.diagnostics["objective"]


def solved_rows(
    coefficients: csr_array, background: NDArray[Any], *, iterations: NDArray[np.int32],
    converged: NDArray[np.bool_], objective: Floats, gap: Floats | None = None,
) -> SparseRows:  # fmt: skip
    """The rows of a `Result`; the background is (m,) or (m, 1 + C), diagnostics are (m,).

    Without a gap it is NaN.
    """
    gap = np.full(len(iterations), np.nan) if gap is None else gap
    diagnostics = {
        "iterations": iterations, "converged": converged, "gap": gap, "objective": objective,
    }  # fmt: skip
    columns = background if background.ndim == 2 else background[:, None]
    return SparseRows(coefficients, columns, diagnostics)


def no_rows(problem: Problem) -> SparseRows:
    """The solution of a problem without rows."""
    dtype = problem.samples.values.dtype
    return solved_rows(
        csr_array((0, problem.patterns.pixels), dtype=dtype), np.zeros((0, 1), dtype),
        iterations=np.zeros(0, np.int32), converged=np.zeros(0, bool), objective=np.zeros(0),
    )  # fmt: skip


# Bytes of the dense rows that are handled at a time: little beside a tile, and few Python calls.
CHUNK_BYTES = 128 << 20


def predictions(problem: Problem, coefficients: csr_array, background: NDArray[Any]) -> Floats:
    """A x + b m for every row, (M, K) float64."""
    result = np.empty(problem.samples.values.shape)
    size = max(1, CHUNK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        chunk = slice(start, start + size)
        rows = coefficients[chunk].toarray().astype(np.float64)
        result[chunk] = problem.patterns.forward(rows)
    if not problem.background:
        return result
    return result + np.outer(np.asarray(background, np.float64), problem.column)


def objective(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity | str
) -> Floats:
    """The problem's objective for each row, (M,) float64."""
    u = predictions(problem, coefficients, background)
    term, observed = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    norm = np.asarray(np.abs(coefficients).sum(axis=1, dtype=np.float64)).ravel()
    misfit = (observed.weights * term.value(u, observed)).sum(axis=1)
    return np.asarray(problem.regularization * norm + misfit)
