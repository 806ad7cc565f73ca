"""ADMM, the clip-blind l1 minimisation of the paper (Section 3.1, Eq. 7-13).

The linear system of its x-update (Eq. 10 and 17) is factored once for all camera samples. The
unknowns of a row are its N pixels and, with a background, one more: c = sum x + b, the response to
an all-white pattern. In x and c the prediction is

    P x + b m = (P - m 1') x + c m,

so pixels act through the centred patterns only. That removes the direction in which all columns of
0/1 patterns are alike, whose eigenvalue is about N times as large as the others. The z-update is a
soft threshold (Eq. 12 and 13). `SaturationADMM` shares both.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lightmatrix.defaults import ADMM_ITERATIONS
from lightmatrix.errors import SolverError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import check_at_least_one, check_positive
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.loop import IterativeSolver
from lightmatrix.solvers.problem import Problem


@dataclass(frozen=True, eq=False)
class System:
    """Regularized least squares with A = P or, with a background, A = [P - m 1', scale m].

    `ridge` is > 0. `column` is m, (K,); the last unknown is c / scale. `row_scale` (K,) multiplies
    the rows of A: the square roots of the patterns' weights; None means 1.
    """

    patterns: PatternSet
    ridge: float
    column: NDArray[np.float64] | None
    row_scale: NDArray[np.float64] | None = None

    @property
    def unknowns(self) -> int:
        """N, or N + 1 with a background."""
        return self.patterns.pixels + int(self.column is not None)

    @cached_property
    def scale(self) -> float:
        """The unit of c: its column is then as long as a typical row of the centred patterns."""
        if self.column is None:
            return 1.0
        energy = float(np.median(centred_energy(self.patterns, self.column)))
        length = float(np.linalg.norm(self.column))
        return float(np.sqrt(energy) / length) if energy > 0 and length > 0 else 1.0

    @property
    def _wide(self) -> bool:
        return self.patterns.count <= self.patterns.pixels

    @cached_property
    def _inverse(self) -> NDArray[np.float64]:
        """(A A' + ridge I)^-1, or that of A' A if smaller, so that each solve is one product."""
        column = self.column
        rows = np.ones(self.patterns.count) if self.row_scale is None else self.row_scale
        if self._wide:
            square = self.patterns.gram
            if column is not None:
                crossed = np.outer(_sums(self.patterns, column), column)
                change = self.scale**2 + self.patterns.pixels
                square = square - crossed - crossed.T + change * np.outer(column, column)
            square = square * np.outer(rows, rows)
        else:
            matrix = self.patterns.dense().astype(np.float64)
            if column is not None:
                matrix = np.column_stack([matrix - column[:, None], self.scale * column])
            matrix *= rows[:, None]
            square = matrix.T @ matrix
        square = square + self.ridge * np.eye(square.shape[-1])
        return np.asarray(np.linalg.inv(square), np.float64)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        """A x for rows x of (M, unknowns): (M, K)."""
        pixels = x[:, : self.patterns.pixels]
        samples = self.patterns.forward(pixels)
        if self.column is not None:
            level = self.scale * x[:, -1] - pixels.sum(axis=1)
            samples += np.multiply.outer(level, self.column).astype(x.dtype)
        if self.row_scale is not None:
            samples *= self.row_scale.astype(x.dtype)
        return samples

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        """A' e for rows e of (M, K): (M, unknowns)."""
        if self.row_scale is not None:
            e = e * self.row_scale.astype(e.dtype)
        correlations = self.patterns.adjoint(e)
        if self.column is None:
            return correlations
        along = e @ self.column.astype(e.dtype)
        result = np.empty((len(e), self.unknowns), e.dtype)
        np.subtract(correlations, along[:, None], out=result[:, :-1])
        result[:, -1] = self.scale * along
        return result

    def solve(self, target: NDArray[Any], point: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """argmin_x ||A x - target||^2 + ridge ||x - point||^2, and its prediction A x.

        `target` is (M, K), `point` (M, unknowns); the results have the dtype of `point`. x is
        (A' A + ridge I)^-1 (A' target + ridge point). By the matrix inversion lemma it equals
        point + A' t with t = (A A' + ridge I)^-1 (target - A point), and A x = target - ridge t.
        That takes one product with A and one with A'. It subtracts no large numbers, so single
        precision is enough.
        """
        dtype = point.dtype
        distance = target - self.forward(point)
        if self._wide:
            t = _each_by(distance.astype(np.float64), self._inverse)
            prediction = target - (self.ridge * t).astype(dtype)
            return point + self.adjoint(t.astype(dtype)), prediction
        step = _each_by(self.adjoint(distance).astype(np.float64), self._inverse)
        x = point + step.astype(dtype)
        return x, self.forward(x)

    def split(self, z: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Split unknowns into coefficients (M, N) and background b = c - sum x, (M,)."""
        if self.column is None:
            return z, np.zeros(len(z), z.dtype)
        coefficients = z[:, :-1]
        b = self.scale * z[:, -1].astype(np.float64) - coefficients.sum(axis=1, dtype=np.float64)
        return coefficients, b.astype(z.dtype)


def system_of(
    problem: Problem, ridge: float, row_scale: NDArray[np.float64] | None = None
) -> System:
    """The system of a problem."""
    column = problem.column if problem.background else None
    return System(problem.patterns, ridge, column, row_scale)


def centred_energy(patterns: PatternSet, column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared lengths of the centred patterns P - m 1', (K,); N / 4 for fair coins."""
    energy = np.diagonal(patterns.gram) - 2 * _sums(patterns, column) * column
    return np.maximum(energy + patterns.pixels * column**2, 0)


def _sums(patterns: PatternSet, column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of each pattern over its pixels, (K,)."""
    # If the column is the means, compute the sums from it, so that all terms of the centred Gram
    # matrix have the same rounding.
    return patterns.pixels * column if column is patterns.means else patterns.sums


def _each_by(rows: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows times one matrix, or equal groups of rows times one matrix each (trials of Fig. 4)."""
    if matrix.ndim == 2:
        return rows @ matrix
    return (rows.reshape(len(matrix), -1, rows.shape[1]) @ matrix).reshape(rows.shape)


# Number of rows that are handled at a time in double precision, to save memory.
_CAPPED_ROWS = 64


def soft_threshold(
    q: NDArray[Any], threshold: ArrayLike, *, nonnegative: bool = False
) -> NDArray[Any]:
    """argmin_z threshold |z| + (q - z)^2 / 2 (Eq. 12), over z >= 0 if `nonnegative`."""
    shrunk = np.maximum(q - threshold, 0)
    return shrunk if nonnegative else shrunk - np.maximum(-q - threshold, 0)


def capped_soft_threshold(
    q: NDArray[Any], total: NDArray[Any], threshold: float, scale: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Minimise threshold sum z + ||q - z||^2 / 2 + (total - c)^2 / 2 over z >= 0 under a cap.

    The cap is sum z <= scale c (Eq. 13 with the bound b >= 0); q and z are (M, N), total and c
    (M,). Where it binds, thresholds rise by tau and c by scale tau. tau is the root of a convex,
    piecewise linear function, to which Newton's steps from 0 rise without overshoot.
    """
    z, c = soft_threshold(q, threshold, nonnegative=True), total.copy()
    over = np.flatnonzero(z.sum(axis=1) > scale * total)
    for start in range(0, len(over), _CAPPED_ROWS):
        rows = over[start : start + _CAPPED_ROWS]
        tau = _rise(z[rows].astype(np.float64), scale * total[rows].astype(np.float64), scale**2)
        z[rows] = np.maximum(z[rows] - tau[:, None], 0)
        c[rows] = total[rows] + scale * tau
    return z, c


def _rise(z: NDArray[np.float64], cap: NDArray[np.float64], give: float) -> NDArray[np.float64]:
    """The tau of each row with sum max(z - tau, 0) = cap + give tau."""
    tau, left = np.zeros(len(z)), z
    # Limit of Newton steps. Each step passes at least one kink of the function, and most pass many.
    for _ in range(100):
        excess = left.sum(axis=1) - cap - give * tau
        step = np.maximum(excess / ((left > 0).sum(axis=1) + give), 0)
        tau += step
        if (step <= 1e-12 * tau).all():
            break
        left = np.maximum(z - tau[:, None], 0)
    return tau


@dataclass(frozen=True)
class ADMMState:
    """x, z and the multiplier h, each (M, unknowns); y, (M, K); the data that all rows share."""

    x: NDArray[Any]
    z: NDArray[Any]
    h: NDArray[Any]
    y: NDArray[Any]
    system: System
    penalty_x: float


class Splitting(IterativeSolver):
    """What these solvers share; both ADMMs end at z, the part of the split x = z that is sparse."""

    penalty_x: float | None

    def __post_init__(self) -> None:
        check_positive(penalty_x=self.penalty_x, tolerance=self.tolerance)
        check_at_least_one(max_iterations=self.max_iterations)

    def solution(self, problem: Problem, state: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Coefficients (M, N) and background (M,)."""
        coefficients, background = state.system.split(state.z)
        return coefficients, background


@dataclass(frozen=True)
class ADMM(Splitting):
    """Clip-blind l1 minimisation (Eq. 2), solved by ADMM.

    ::

        min ||z||_1 + 1/(2 lambda) ||y - A x||^2   with x = z                       (7)

    Parameters
    ----------
    penalty_x : float or None
        The paper's mu, > 0, in 1 / (units of T). None: computed by `automatic_penalty_x`; for 0/1
        patterns of density 0.5 it is sqrt(K N) / (24 lambda).
    max_iterations : int
        Limit of iterations, at least 1. A row that reaches it is returned as it is.
    tolerance : float
        A row stops when its relative primal and dual residuals are at most this, > 0.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32)).bin(camera=16)
    >>> problem = lm.Problem(capture.patterns, capture.samples(), regularization=0.1)
    >>> lm.solve(problem, lm.ADMM()).coefficients.shape
    (16, 4096)
    """

    penalty_x: float | None = None
    max_iterations: int = ADMM_ITERATIONS
    tolerance: float = 5e-4

    # No parameter: the system of ADMM is that of least squares.
    fidelity = Fidelity.LINEAR

    def init(self, problem: Problem) -> ADMMState:
        mu = self.penalty_x or automatic_penalty_x(problem)
        scale = shared_weights(problem)
        system = system_of(problem, mu * problem.regularization, scale)
        y = problem.samples.values
        if scale is not None:
            y = y * scale.astype(y.dtype)
        zero = np.zeros((problem.rows, system.unknowns), y.dtype)
        return ADMMState(zero, zero, zero, y, system, mu)

    def step(self, problem: Problem, state: ADMMState) -> ADMMState:
        mu = state.penalty_x
        x, z, h = state.x, state.z, state.h
        # Eq. 9
        h = h + mu * (x - z)
        # Eq. 10
        x, _ = state.system.solve(state.y, z - h / mu)
        # Eq. 13
        z = shrink(x + h / mu, mu, problem, state.system)
        return ADMMState(x, z, h, state.y, state.system, mu)

    def residuals(
        self, problem: Problem, before: ADMMState, after: ADMMState
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        threshold = 1 / after.penalty_x
        primal = relative(after.x - after.z, threshold, after.x, after.z)
        dual = relative(after.z - before.z, threshold, after.z, after.h * threshold)
        return primal, dual

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: 13 float32 vectors of pixels, for two states and a step."""
        return 4 * (13 * pixels + 6 * patterns)


def shrink(q: NDArray[Any], penalty_x: float, problem: Problem, system: System) -> NDArray[Any]:
    """The z-update, Eq. 13. With a background and nonnegative light also b = c - sum z >= 0."""
    if not problem.background:
        return soft_threshold(q, 1 / penalty_x, nonnegative=problem.nonnegative)
    z = q.copy()
    if problem.nonnegative:
        z[:, :-1], z[:, -1] = capped_soft_threshold(
            q[:, :-1], q[:, -1], 1 / penalty_x, system.scale
        )
    else:
        z[:, :-1] = soft_threshold(q[:, :-1], 1 / penalty_x)
    return z


def relative(difference: NDArray[Any], floor: float, *sizes: NDArray[Any]) -> NDArray[Any]:
    """Row norms of a difference over the largest of `sizes`, at least `floor` to stop dark rows."""
    scale = np.max([np.linalg.norm(size, axis=1) for size in sizes], axis=0)
    return np.linalg.norm(difference, axis=1) / np.maximum(scale, floor)


def automatic_penalty_x(problem: Problem) -> float:
    """The penalty mu with lambda mu = sqrt(r c) / 6, by mean squared lengths of rows and columns.

    For 0/1 patterns of density 0.5, lambda mu = sqrt(K N) / 24. The sixth was chosen on rendered
    scenes with K from 64 to 1,024 and lambda from 0.08 to 0.32. With half of it, dense rows
    converge slowly; with twice of it, rows with large entries do, which grow by at most 1 / mu a
    step.
    """
    patterns = problem.patterns
    total = float(centred_energy(patterns, problem.column).sum())
    typical = total / np.sqrt(patterns.count * patterns.pixels) if total > 0 else 1.0
    return float(typical / (6 * problem.regularization))


def shared_weights(problem: Problem) -> NDArray[np.float64] | None:
    """The square roots of the weights, (K,), which all rows must share; None without weights."""
    weights = problem.samples.weights
    if weights is None:
        return None
    if weights.ndim == 2:
        if len(weights) and (weights != weights[:1]).any():
            raise SolverError(
                "ADMM factors one matrix for all rows, but the weights differ between rows",
                hint="use Saturation ADMM with the linear fidelity, which allows any weights",
            )
        weights = weights[0] if len(weights) else np.ones(problem.patterns.count)
    return np.sqrt(weights.astype(np.float64))


@dataclass(frozen=True)
class SaturationADMMState:
    """x, z, h, (M, unknowns); u, g and the prediction A x, (M, K); the data that all rows share."""

    x: NDArray[Any]
    z: NDArray[Any]
    u: NDArray[Any]
    h: NDArray[Any]
    g: NDArray[Any]
    prediction: NDArray[Any]
    system: System
    penalty_x: float
    penalty_u: float


@dataclass(frozen=True)
class SaturationADMM(Splitting):
    """l1 minimisation through a clipping camera (Eq. 6), solved by ADMM.

    ::

        min ||z||_1 + 1/(2 lambda) ||y - C_Y(u)||^2   with x = z, A x = u            (14)

    The updates and their order (h, g, u, x, z) are the paper's. Other fidelities change only the
    u-update. With `clipped` the problem is not convex; iterations start at u = y, x = z = 0.

    Parameters
    ----------
    fidelity : Fidelity
        clipped (the paper), one-sided, rejection or linear.
    penalty_u : float or None
        The paper's nu, > 0, in 1 / (units of camera sample). None: 1 / (8 lambda), which Eq. 18
        adds to the data term's 1.
    penalty_x, max_iterations, tolerance
        As for `ADMM`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32)).bin(camera=16)
    >>> problem = lm.Problem(capture.patterns, capture.samples(), regularization=0.1)
    >>> lm.solve(problem, lm.SaturationADMM()).coefficients.shape
    (16, 4096)
    """

    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    penalty_x: float | None = None
    penalty_u: float | None = None
    max_iterations: int = ADMM_ITERATIONS
    tolerance: float = 5e-4

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", Fidelity(self.fidelity))
        check_positive(penalty_u=self.penalty_u)
        super().__post_init__()

    def init(self, problem: Problem) -> SaturationADMMState:
        mu = self.penalty_x or automatic_penalty_x(problem)
        nu = self.penalty_u or 1 / (8 * problem.regularization)
        system = system_of(problem, mu / nu)
        y = problem.samples.values
        x = np.zeros((problem.rows, system.unknowns), y.dtype)
        return SaturationADMMState(x, x, y, x, np.zeros_like(y), np.zeros_like(y), system, mu, nu)

    def step(self, problem: Problem, state: SaturationADMMState) -> SaturationADMMState:
        mu, nu, lam = state.penalty_x, state.penalty_u, problem.regularization
        x, z, u, h, g = state.x, state.z, state.u, state.h, state.g
        # Eq. 16
        h = h + mu * (x - z)
        g = g + nu * (state.prediction - u)
        # Eq. 18-21
        v = state.prediction + g / nu
        u = Fidelity(self.fidelity).term.update(v, problem.observed, lam * nu)
        # Eq. 17
        x, prediction = state.system.solve(u - g / nu, z - h / mu)
        # Eq. 13
        z = shrink(x + h / mu, mu, problem, state.system)
        return SaturationADMMState(x, z, u, h, g, prediction, state.system, mu, nu)

    def residuals(
        self, problem: Problem, before: SaturationADMMState, after: SaturationADMMState
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        # Residuals of samples are relative to their norm, but at least to this share of lambda, so
        # that rows without light can stop. Chosen by hand, far below any lit row.
        threshold, dark = 1 / after.penalty_x, 1e-3 * problem.regularization
        primal = np.maximum(
            relative(after.x - after.z, threshold, after.x, after.z),
            relative(after.prediction - after.u, dark, after.prediction, after.u),
        )
        dual = np.maximum(
            relative(after.z - before.z, threshold, after.z, after.h * threshold),
            relative(after.u - before.u, dark, after.u, after.g / after.penalty_u),
        )
        return primal, dual

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: 13 float32 vectors of pixels, for two states and a step."""
        return 4 * (13 * pixels + 14 * patterns)
