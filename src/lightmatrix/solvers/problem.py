"""The input and the output of all solvers, `Problem` and `Result`, for many rows at once.

Objectives and duality gaps are computed in float64 from their definitions.
"""

from __future__ import annotations

from collections.abc import Iterator
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
from lightmatrix.reprs import short_repr
from lightmatrix.solvers.fidelity import DataTerm, Fidelity, Observed
from lightmatrix.transport.sparse_rows import SparseRows

Floats = NDArray[np.float64]


class Status(StrEnum):
    """Why a row stopped, and the remedy."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached: raise the limit or the tolerance"
    NOT_FINITE = "left the finite numbers: check the samples, raise the regularization"


@dataclass(frozen=True)
class Problem:
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

    __repr__ = short_repr

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

    def take(self, rows: NDArray[np.integer]) -> Problem:
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


@dataclass(frozen=True)
class Result:
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

    __repr__ = short_repr

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
        """Relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2), (M,); NaN if not convex."""
        return self.rows.diagnostics["gap"]

    @property
    def objective(self) -> Floats:
        """The objective with the solver's fidelity, (M,)."""
        return self.rows.diagnostics["objective"]


def solved_rows(
    coefficients: csr_array, background: NDArray[Any], *, iterations: NDArray[np.int32],
    converged: NDArray[np.bool_], gap: Floats, objective: Floats,
) -> SparseRows:  # fmt: skip
    """The rows of a `Result`; the background is (m,) or (m, 1 + C), diagnostics are (m,)."""
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
        iterations=np.zeros(0, np.int32), converged=np.zeros(0, bool), gap=np.zeros(0),
        objective=np.zeros(0),
    )  # fmt: skip


# Bytes of the dense rows that are handled at a time: little beside a tile, and few Python calls.
CHUNK_BYTES = 128 << 20


def predictions(problem: Problem, coefficients: csr_array, background: NDArray[Any]) -> Floats:
    """A x + b m for every row, (M, K) float64."""
    result = np.empty(problem.samples.values.shape)
    for chunk in _chunks(problem):
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
    return _norm(problem, coefficients) + _data_term(observed, u, term)


def relative_gap(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity | str
) -> tuple[Floats, Floats]:
    """Objective P and relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2), each (M,) float64.

    The dual of min lambda ||x||_1 + sum w f(A x + b m) is: maximise sum y theta - theta^2 / (2 w),
    since the conjugate of a convex f is t^2 / 2 where it is finite, subject to A' theta <= lambda
    (in absolute value if x may be negative), theta >= 0 where one-sided, and m' theta <= 0 (= 0 if
    b may be negative). The dual point is the weighted residual, shifted along m and scaled to be
    feasible. A fidelity that is not convex has the gap NaN.
    """
    term, observed = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    u = predictions(problem, coefficients, background)
    primal = _norm(problem, coefficients) + _data_term(observed, u, term)
    if not term.convex:
        return primal, np.full(problem.rows, np.nan)
    dual = _dual_value(problem, observed, u, term)
    # The gap is relative to the objective, but at least to this share of ||y||^2 / 2, so that rows
    # without light can converge. The compiled solver uses the same share.
    floor = 1e-6 * (observed.values**2).sum(axis=1) / 2
    scale = np.maximum(np.maximum(primal, floor), np.finfo(np.float64).tiny)
    return primal, (primal - dual) / scale


def _chunks(problem: Problem) -> Iterator[slice]:
    """Slices of the rows whose dense coefficients take up to `CHUNK_BYTES`."""
    size = max(1, CHUNK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        yield slice(start, start + size)


def _norm(problem: Problem, coefficients: csr_array) -> Floats:
    sums = np.abs(coefficients).sum(axis=1, dtype=np.float64)
    return problem.regularization * np.asarray(sums).ravel()


def _data_term(observed: Observed, u: Floats, term: DataTerm) -> Floats:
    return np.asarray((observed.weights * term.value(u, observed)).sum(axis=1))


def _dual_value(problem: Problem, observed: Observed, u: Floats, term: DataTerm) -> Floats:
    theta = observed.weights * term.residual(u, observed)
    if problem.background:
        theta = _orthogonal_to_column(
            problem, theta, (observed.weights > 0) & term.two_sided(observed)
        )
    highest = np.empty(problem.rows)
    for chunk in _chunks(problem):
        correlations = problem.patterns.adjoint(theta[chunk])
        part = correlations if problem.nonnegative else np.abs(correlations)
        highest[chunk] = part.max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(highest > 0, problem.regularization / highest, np.inf)
    linear = (observed.values * theta).sum(axis=1)
    over = np.divide(
        theta**2, observed.weights, out=np.zeros_like(theta), where=observed.weights > 0
    )
    quadratic = over.sum(axis=1)
    # D(s theta) is a parabola in s. Take its top, or the largest feasible scaling below it.
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.where(quadratic > 0, linear / quadratic, 0)
    # Limit of the factor that scales the dual point. Near the optimum the best factor is 1; a much
    # larger one would only magnify the rounding errors in m' theta = 0.
    scaling = np.clip(top, 0, np.minimum(limit, 2))
    return np.asarray(scaling * linear - scaling**2 * quadratic / 2)


def _orthogonal_to_column(problem: Problem, theta: Floats, two_sided: NDArray[np.bool_]) -> Floats:
    """Shift theta on the two-sided samples until m' theta <= 0, or = 0 if b may be negative."""
    column = problem.column
    excess = theta @ column
    if problem.nonnegative:
        excess = np.maximum(excess, 0)
    energy = two_sided @ column**2
    step = np.divide(excess, energy, out=np.zeros_like(excess), where=energy > 0)
    shifted = theta - step[:, None] * column * two_sided
    # Without two-sided samples only theta = 0 is feasible.
    return np.where((energy <= 0)[:, None] & (excess > 0)[:, None], 0, shifted)
