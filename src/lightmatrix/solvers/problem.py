"""The input and the output of all solvers: `Problem` and `Result`, for many rows at once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import short_repr
from lightmatrix.solvers.fidelity import Observed
from lightmatrix.transport.sparse_rows import SparseRows


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
    edge_noise : float
        The s of the ``likelihood`` fidelity as a share of each sample's clip level, from 1e-4 to 1:
        how far below the level the prediction of a clipped sample may lie, by noise and misfit.

    Raises
    ------
    InputError
        If shapes do not match, samples are not finite, or values are out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> lm.Problem(patterns, samples, regularization=0.01).rows
    1
    """

    patterns: PatternSet
    samples: Samples
    regularization: float
    nonnegative: bool = True
    background: bool = True
    background_column: NDArray[Any] | None = None
    edge_noise: float = 0.02

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
        if not 1e-4 <= self.edge_noise <= 1:
            raise InputError(
                f"edge_noise is {self.edge_noise}",
                hint="use a share of the clip level from 0.0001 to 1, such as 0.02",
            )

    @property
    def rows(self) -> int:
        """Number of camera samples M."""
        return self.samples.count

    @property
    def column(self) -> NDArray[np.float64]:
        """m, (K,) float64: the column of the background."""
        if self.background_column is None:
            return self.patterns.means
        return np.asarray(self.background_column, np.float64)

    def take(self, rows: NDArray[np.integer]) -> Problem:
        """The problem of some of the rows."""
        return replace(self, samples=self.samples.rows(rows))

    def frames(self, index: NDArray[np.integer]) -> Problem:
        """The problem with some of its patterns."""
        column = self.background_column
        return replace(
            self,
            patterns=self.patterns.subset(index),
            samples=self.samples.frames(index),
            background_column=None if column is None else column[index],
        )

    @cached_property
    def observed(self) -> Observed:
        """The samples for the fidelities, in their own precision."""
        samples = self.samples
        return Observed(
            samples.values,
            samples.clipped,
            samples.clip_levels_of_all(),
            samples.weights_of_all(),
            self.edge_widths(),
        )

    def edge_widths(self) -> NDArray[Any]:
        """The s of the ``likelihood`` fidelity, (M, K), in the dtype of the samples."""
        # The clip level may be 0, where room light fills the whole range, but widths must be above
        # 0.
        tiny = np.finfo(self.samples.values.dtype).tiny
        return np.maximum(
            self.edge_noise * np.abs(self.samples.clip_levels_of_all()), np.sqrt(tiny)
        )


def check_regularization(value: float) -> None:
    """Refuse a regularization that is not a positive number."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(
            f"regularization is {value}",
            hint="use a positive number in units of camera sample, such as 0.3",
        )


@dataclass(frozen=True)
class Result:
    """The solution of a problem.

    Parameters
    ----------
    rows : SparseRows
        The rows, with iterations, convergence, gap and objective as diagnostics.
    status : Status
        The worst status of all rows.
    history : dict of str to list of float
        Residuals or counts per iteration, for plots; empty if the solver keeps none.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> result = lm.solve(lm.Problem(patterns, samples, regularization=0.01), lm.ActiveSet())
    >>> result.converged
    array([ True])
    """

    rows: SparseRows
    status: Status
    history: dict[str, list[float]] = field(default_factory=dict)

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
    def gap(self) -> NDArray[np.float64]:
        """Relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2), (M,); NaN if not convex."""
        return self.rows.diagnostics["gap"]

    @property
    def objective(self) -> NDArray[np.float64]:
        """The objective with the solver's fidelity, (M,)."""
        return self.rows.diagnostics["objective"]


def solved_rows(
    coefficients: csr_array,
    background: NDArray[Any],
    *,
    iterations: NDArray[np.int32],
    converged: NDArray[np.bool_],
    gap: NDArray[np.float64],
    objective: NDArray[np.float64],
) -> SparseRows:
    """The rows of a `Result`; the background is (m,) or (m, 1 + C), diagnostics are (m,)."""
    diagnostics = {
        "iterations": iterations,
        "converged": converged,
        "gap": gap,
        "objective": objective,
    }
    columns = background if background.ndim == 2 else background[:, None]
    return SparseRows(coefficients, columns, diagnostics)


def no_rows(problem: Problem) -> SparseRows:
    """The solution of a problem without rows."""
    dtype = problem.samples.values.dtype
    return solved_rows(
        csr_array((0, problem.patterns.pixels), dtype=dtype),
        np.zeros((0, 1), dtype),
        iterations=np.zeros(0, np.int32),
        converged=np.zeros(0, bool),
        gap=np.zeros(0),
        objective=np.zeros(0),
    )
