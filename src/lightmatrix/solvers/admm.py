"""l1 minimisation by ADMM: the paper's Section 3.1, Eq. 7-13."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, SolverError
from lightmatrix.solvers.problem import Fidelity, Problem
from lightmatrix.solvers.prox import soft_threshold
from lightmatrix.solvers.system import System


@dataclass(frozen=True)
class ADMMState:
    """x, z and the multiplier h, each (M, unknowns); y (M, K) and what all rows share."""

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
        The paper's mu, > 0, in 1 / (units of T). None: 40 over the largest clip level.
    max_iterations : int
        Iterations after which a row is given up as it is.
    tolerance : float
        A row stops when its relative primal and dual residuals are below this.
    """

    penalty_x: float | None = None
    max_iterations: int = 1000
    tolerance: float = 1e-3

    fidelity: ClassVar[Fidelity] = Fidelity.LINEAR

    def __post_init__(self) -> None:
        check_positive(penalty_x=self.penalty_x, tolerance=self.tolerance)

    def init(self, problem: Problem) -> ADMMState:
        mu = self.penalty_x or automatic_penalty(problem)
        scale = _shared_weights(problem)
        system = System(problem.patterns, mu * problem.regularization, problem.background, scale)
        y = (
            problem.samples
            if scale is None
            else problem.samples * scale.astype(problem.samples.dtype)
        )
        zero = np.zeros((problem.rows, system.unknowns), problem.samples.dtype)
        return ADMMState(zero, zero, zero, y, system, mu)

    def step(self, problem: Problem, state: ADMMState) -> ADMMState:
        mu = state.penalty_x
        x, z, h = state.x, state.z, state.h
        # Eq. 9
        h = h + mu * (x - z)
        # Eq. 10
        x, _ = state.system.solve(state.y, z - h / mu)
        # Eq. 13
        z = shrink(x + h / mu, 1 / mu, problem)
        return ADMMState(x, z, h, state.y, state.system, mu)

    def residuals(
        self, problem: Problem, before: ADMMState, after: ADMMState
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        primal = relative(after.x - after.z, after.x, after.z)
        dual = relative(after.z - before.z, after.z, after.h / after.penalty_x)
        return primal, dual

    def solution(self, problem: Problem, state: ADMMState) -> tuple[NDArray[Any], NDArray[Any]]:
        return split(state.z, state.system)

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """x, z, h before and after a step, and what the step needs: 12 vectors of pixels."""
        return 4 * (12 * pixels + 6 * patterns)


def shrink(q: NDArray[Any], threshold: float, problem: Problem) -> NDArray[Any]:
    """Eq. 13 on the pixels; the background coefficient is not penalised."""
    z = soft_threshold(q, threshold, nonnegative=problem.nonnegative)
    if problem.background:
        z[:, -1] = np.maximum(q[:, -1], 0) if problem.nonnegative else q[:, -1]
    return z


def split(z: NDArray[Any], system: System) -> tuple[NDArray[Any], NDArray[Any]]:
    """Unknowns as coefficients (M, N) and background (M,) in units of camera sample."""
    pixels = system.patterns.pixels
    if not system.background:
        return z, np.zeros(len(z), z.dtype)
    return z[:, :pixels], z[:, -1] * z.dtype.type(system.scale)


def relative(difference: NDArray[Any], *sizes: NDArray[Any]) -> NDArray[Any]:
    """Row norms of a difference over the largest row norm of what it is compared with."""
    scale = np.max([np.linalg.norm(size, axis=1) for size in sizes], axis=0)
    size = np.linalg.norm(difference, axis=1)
    return np.divide(size, scale, out=np.where(np.isfinite(size), 0, size), where=scale > 0)


def automatic_penalty(problem: Problem) -> float:
    """mu: the threshold 1 / mu of Eq. 13 is a fortieth of the largest clip level."""
    level = float(np.max(problem.clip_level, initial=0))
    return 40 / level if np.isfinite(level) and level > 0 else 40.0


def check_positive(**values: float | None) -> None:
    """Refuse parameters that are not positive; None means automatic."""
    for name, value in values.items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", hint="use a positive number")


def _shared_weights(problem: Problem) -> NDArray[np.float64] | None:
    """Square roots of the patterns' weights, if all rows share them."""
    weights = problem.weights
    if weights is None:
        return None
    if weights.ndim == 2:
        if len(weights) and (weights != weights[:1]).any():
            raise SolverError(
                "ADMM factors one matrix for all rows, but the weights differ between rows",
                hint="use Saturation ADMM with the linear fidelity: it takes any weights",
            )
        weights = weights[0] if len(weights) else np.ones(problem.patterns.count)
    return np.sqrt(weights.astype(np.float64))
