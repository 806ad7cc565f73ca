"""Saturation ADMM, the l1 minimisation through a clipping camera (Section 3.2, Eq. 14-21)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import ADMM_ITERATIONS
from lightmatrix.ranges import check_at_least_one, check_positive
from lightmatrix.solvers.admm import System, automatic_penalty_x, relative, shrink, system_of
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem


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
class SaturationADMM:
    """l1 minimisation through a clipping camera (Eq. 6), solved by ADMM.

    ::

        min ||z||_1 + 1/(2 lambda) ||y - C_Y(u)||^2   with x = z, A x = u            (14)

    The updates and their order (h, g, u, x, z) are the paper's. Other fidelities change only the
    u-update. With `clipped` the problem is not convex; iterations start at u = y, x = z = 0.

    Parameters
    ----------
    fidelity : Fidelity
        clipped (the paper), one-sided, rejection or linear.
    penalty_x : float or None
        The paper's mu, > 0, in 1 / (units of T). None: computed by `automatic_penalty_x`; for 0/1
        patterns of density 0.5 it is sqrt(K N) / (24 lambda).
    penalty_u : float or None
        The paper's nu, > 0, in 1 / (units of camera sample). None: 1 / (8 lambda).
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
    >>> result = lm.solve(lm.Problem(patterns, samples, regularization=0.01), lm.SaturationADMM())
    >>> int(result.coefficients.toarray().argmax())
    5
    """

    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    penalty_x: float | None = None
    penalty_u: float | None = None
    max_iterations: int = ADMM_ITERATIONS
    tolerance: float = 5e-4

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", Fidelity(self.fidelity))
        check_positive(penalty_x=self.penalty_x, penalty_u=self.penalty_u, tolerance=self.tolerance)
        check_at_least_one(max_iterations=self.max_iterations)

    def init(self, problem: Problem) -> SaturationADMMState:
        mu = self.penalty_x or automatic_penalty_x(problem)
        nu = self.penalty_u or automatic_penalty_u(problem)
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

    def solution(
        self, problem: Problem, state: SaturationADMMState
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        return state.system.split(state.z)

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: 13 float32 vectors of pixels, for two states, a step and the gap."""
        return 4 * (13 * pixels + 14 * patterns)


def automatic_penalty_u(problem: Problem) -> float:
    """The penalty nu with lambda nu = 1/8, which Eq. 18 adds to the data term's 1."""
    return 1 / (8 * problem.regularization)
