"""ADMM, the clip-blind l1 minimisation of the paper (Section 3.1, Eq. 7-13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import SolverError
from lightmatrix.ranges import check_at_least_one, check_positive
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem
from lightmatrix.solvers.prox import capped_soft_threshold, soft_threshold
from lightmatrix.solvers.system import System, centred_energy, system_of


@dataclass(frozen=True)
class ADMMState:
    """x, z and the multiplier h, each (M, unknowns); y, (M, K); the data that all rows share."""

    x: NDArray[Any]
    z: NDArray[Any]
    h: NDArray[Any]
    y: NDArray[Any]
    system: System
    penalty_x: float


@dataclass(frozen=True)
class ADMM:
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
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> result = lm.solve(lm.Problem(patterns, samples, regularization=0.01), lm.ADMM())
    >>> int(result.coefficients.toarray().argmax())
    5
    """

    penalty_x: float | None = None
    max_iterations: int = 1000
    tolerance: float = 5e-4

    fidelity: ClassVar[Fidelity] = Fidelity.LINEAR

    def __post_init__(self) -> None:
        check_positive(penalty_x=self.penalty_x, tolerance=self.tolerance)
        check_at_least_one(max_iterations=self.max_iterations)

    def init(self, problem: Problem) -> ADMMState:
        mu = self.penalty_x or automatic_penalty_x(problem)
        scale = _shared_weights(problem)
        system = system_of(problem, mu * problem.regularization, scale)
        y = (
            problem.samples.values
            if scale is None
            else problem.samples.values * scale.astype(problem.samples.values.dtype)
        )
        zero = np.zeros((problem.rows, system.unknowns), problem.samples.values.dtype)
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

    def solution(self, problem: Problem, state: ADMMState) -> tuple[NDArray[Any], NDArray[Any]]:
        return state.system.split(state.z)

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: 13 float32 vectors of pixels, for two states, a step and the gap."""
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


def _shared_weights(problem: Problem) -> NDArray[np.float64] | None:
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
