"""Rows that are pictures, such as those of a single-pixel camera: least total variation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.sparse import csr_array

from lightmatrix.ranges import check_at_least_one, check_positive
from lightmatrix.solvers.admm import System, relative
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.loop import IterativeSolver
from lightmatrix.solvers.problem import Floats, Problem, objective


@dataclass(frozen=True)
class _State:
    """The picture z and its copies; samples u; scaled duals; the system that all rows share."""

    z: Floats
    x: Floats
    light: Floats
    slopes: Floats
    u: Floats
    x_dual: Floats
    light_dual: Floats
    slopes_dual: Floats
    u_dual: Floats
    system: System


@dataclass(frozen=True)
class TotalVariation(IterativeSolver):
    """min_x regularization * TV(x) + sum_k w_k f_k(a_k . x), with x >= 0 if `nonnegative`.

    TV is the sum over pixels of the length of the differences to the pixel below and to the right
    (Rudin, Osher and Fatemi 1992). It leaves an even background free, so that the problem's has no
    coefficient of its own. ADMM with u = P x, x = z, s = D z and v = z, v >= 0 alternates between
    (x, s, v) and (z, u) (Afonso, Bioucas-Dias and Figueiredo 2011).
    """

    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    max_iterations: int = 1000
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", Fidelity(self.fidelity))
        check_at_least_one(max_iterations=self.max_iterations)
        check_positive(tolerance=self.tolerance)

    def init(self, problem: Problem) -> _State:
        patterns, values = problem.patterns, problem.samples.values
        # Twice to four times the penalty over a typical pixel converges fastest, whatever the unit.
        level = float(np.abs(values).sum() / (max(len(values), 1) * patterns.sums.sum()))
        system = System(patterns, 3 * problem.regularization / max(level, 1e-30), None)
        zero = np.zeros((len(values), patterns.pixels))
        slopes, u = _slopes(zero, patterns.shape), values.astype(np.float64)
        return _State(zero, zero, zero, slopes, u, zero, zero, slopes, 0 * u, system)

    def step(self, problem: Problem, state: _State) -> _State:
        shape, observed = problem.patterns.shape, problem.observed.astype(np.float64)
        x, samples = state.system.solve(state.u - state.u_dual, state.z - state.x_dual)
        # Slopes get shorter by the penalty, whatever their direction.
        slopes = _slopes(state.z, shape) + state.slopes_dual
        length = np.sqrt(np.square(slopes).sum(axis=1, keepdims=True))
        threshold = problem.regularization / state.system.ridge
        slopes *= np.maximum(1 - threshold / np.maximum(length, 1e-300), 0)
        light = state.z + state.light_dual
        light = np.maximum(light, 0) if problem.nonnegative else light
        # (2 + D' D) z = x + x_dual + light - light_dual + D' (slopes - slopes_dual).
        z = x + state.x_dual + light - state.light_dual
        z = _solve(z + _adjoint(slopes - state.slopes_dual), shape)
        u = Fidelity(self.fidelity).term.update(samples + state.u_dual, observed, 1.0)
        x_dual, light_dual = state.x_dual + x - z, state.light_dual + z - light
        u_dual, slopes_dual = state.u_dual + samples - u, state.slopes_dual - slopes
        slopes_dual += _slopes(z, shape)
        return _State(z, x, light, slopes, u, x_dual, light_dual, slopes_dual, u_dual, state.system)

    def residuals(
        self, problem: Problem, before: _State, after: _State
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        primal = relative(after.x - after.light, 1e-30, after.x, after.light)
        return primal, relative(after.z - before.z, 1e-30, after.z, before.z)

    def solution(self, problem: Problem, state: _State) -> tuple[NDArray[Any], NDArray[Any]]:
        """Coefficients (M, N), and no background."""
        dtype = problem.samples.values.dtype
        return state.light.astype(dtype), np.zeros(len(state.light), dtype)

    def objective(self, problem: Problem, x: csr_array, background: NDArray[Any]) -> Floats:
        """What is minimised, (M,): the data term, beside which this l1 norm is nothing."""
        data = objective(replace(problem, regularization=1e-300), x, background, self.fidelity)
        slopes = _slopes(x.toarray().astype(np.float64), problem.patterns.shape)
        lengths = np.sqrt(np.square(slopes).sum(axis=1))
        return np.asarray(data + problem.regularization * lengths.sum(axis=(1, 2)))

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: two states and a step, in double precision."""
        return 8 * (30 * pixels + 6 * patterns)


def _slopes(pictures: Floats, shape: tuple[int, int]) -> Floats:
    """D z: differences of (M, N) to the pixels below and to the right, (M, 2, rows, cols)."""
    images = pictures.reshape(-1, *shape)
    slopes = np.zeros((len(images), 2, *shape))
    slopes[:, 0, :-1] = np.diff(images, axis=1)
    slopes[:, 1, :, :-1] = np.diff(images, axis=2)
    return slopes


def _adjoint(slopes: Floats) -> Floats:
    """D' s, (M, N)."""
    down, right = slopes[:, 0, :-1], slopes[:, 1, :, :-1]
    images = np.zeros(slopes[:, 0].shape)
    images[:, 1:] += down
    images[:, :-1] -= down
    images[:, :, 1:] += right
    images[:, :, :-1] -= right
    return images.reshape(len(images), -1)


def _solve(pictures: Floats, shape: tuple[int, int]) -> Floats:
    """(2 + D' D)^-1 z: cosines are the eigenvectors of differences that end at the border."""
    down, right = (2 - 2 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    waves = dctn(pictures.reshape(-1, *shape), axes=(1, 2), norm="ortho")
    waves /= 2 + down[:, None] + right
    return np.asarray(idctn(waves, axes=(1, 2), norm="ortho")).reshape(pictures.shape)
