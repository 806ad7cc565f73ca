"""Rows that are pictures: total variation in place of the l1 norm, by ADMM.

A bucket detector, or a camera pixel behind a diffuser, sees all of the scene, and its row of T is a
picture rather than a few spots. Pictures consist of surfaces, so their differences are sparse:

    min_x  lambda TV(x) + sum_k w_k f_k(a_k . x)  with x >= 0

(Rudin, Osher & Fatemi, Physica D 60, 1992; for one detector, Duarte et al. 2008). ADMM splits x
into a copy z that the patterns see, the differences g = D x, and a copy v >= 0, as Goldstein &
Osher 2009 (split Bregman) do. The update of x then is a filter, of which the cosine transform is
diagonal. Diffuse light is a constant picture, which has no variation, so a background adds nothing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.defaults import ADMM_ITERATIONS
from lightmatrix.solvers import admm
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, objective


@dataclass(frozen=True)
class VariationState:
    """Pictures x and v (M, rows, cols), A z (M, K), and the scaled multipliers of the splits."""

    x: NDArray[Any]
    v: NDArray[Any]
    prediction: NDArray[Any]
    of_z: NDArray[Any]
    of_v: NDArray[Any]
    of_g: NDArray[Any]
    system: admm.System


@dataclass(frozen=True)
class TotalVariation(admm.Splitting):
    """Least squares and the total variation of each row, which is a picture on the projector.

    Parameters
    ----------
    penalty_x, max_iterations, tolerance
        As for `ADMM`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> picture = np.kron(np.eye(2), np.ones((8, 8)))
    >>> patterns = lm.make_patterns("hadamard", (16, 16), count=64)
    >>> values = patterns.forward(picture.reshape(1, -1))
    >>> samples = lm.Samples(values, values > 999, np.full(64, 999.0))
    >>> problem = lm.Problem(patterns, samples, regularization=0.1, background=False)
    >>> found = lm.solve(problem, lm.TotalVariation()).coefficients.toarray()
    >>> bool(np.abs(found - picture.ravel()).max() < 0.05)
    True
    """

    penalty_x: float | None = None
    max_iterations: int = ADMM_ITERATIONS
    tolerance: float = 1e-4

    # A clipped sample is a lower bound.
    fidelity = Fidelity.ONE_SIDED

    def init(self, problem: Problem) -> VariationState:
        mu = self.penalty_x or admm.automatic_penalty_x(problem)
        scale = admm.shared_weights(problem)
        system = admm.System(problem.patterns, mu * problem.regularization, None, scale)
        zero = np.zeros((problem.rows, *problem.patterns.shape), problem.samples.values.dtype)
        seen, of_g = np.zeros_like(problem.samples.values), np.stack([zero, zero], axis=1)
        return VariationState(zero, zero, seen, _flat(zero), zero, of_g, system)

    def step(self, problem: Problem, state: VariationState) -> VariationState:
        values, x = problem.samples.values, state.x
        if state.system.row_scale is not None:
            values = values * state.system.row_scale.astype(values.dtype)
        # What is predicted above a clipped sample may be right.
        bound = np.maximum(values, state.prediction)
        values = np.where(problem.samples.clipped, bound, values)
        z, prediction = state.system.solve(values, _flat(x) - state.of_z)
        v = x - state.of_v
        v = np.maximum(v, 0) if problem.nonnegative else v
        steps = differences(x) - state.of_g
        threshold = problem.regularization / state.system.ridge
        length = np.linalg.norm(steps, axis=1, keepdims=True)
        g = steps * (np.maximum(length - threshold, 0) / np.maximum(length, 1e-30))
        of_z, of_v, of_g = state.of_z + z, state.of_v + v, state.of_g + g
        x = _filtered(of_z.reshape(x.shape) + of_v + adjoint(of_g))
        left = of_z - _flat(x), of_v - x, of_g - differences(x)
        return VariationState(x, v, prediction, *left, state.system)

    def residuals(
        self, problem: Problem, before: VariationState, after: VariationState
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        floor = problem.regularization / after.system.ridge
        x = _flat(after.x)
        splits = (after.of_z, before.of_z), (after.of_v, before.of_v), (after.of_g, before.of_g)
        primal = [admm.relative(_flat(new) - _flat(old), floor, x) for new, old in splits]
        return np.max(primal, axis=0), admm.relative(x - _flat(before.x), floor, x)

    def solution(self, problem: Problem, state: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Coefficients (M, N), and no background."""
        return _flat(state.v), np.zeros(len(state.v), state.v.dtype)

    def objective(
        self, problem: Problem, x: scipy.sparse.csr_array, background: NDArray[Any]
    ) -> NDArray[np.float64]:
        """The regularized variation and the misfit, (M,)."""
        pictures = x.toarray().astype(np.float64).reshape(-1, *problem.patterns.shape)
        variation = np.linalg.norm(differences(pictures), axis=1).sum(axis=(1, 2))
        norm = np.abs(pictures).sum(axis=(1, 2))
        whole = objective(problem, x, background, self.fidelity)
        return np.asarray(whole + problem.regularization * (variation - norm))

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: 22 float32 vectors of pixels, for two states and a step."""
        return 4 * (22 * pixels + 6 * patterns)


def differences(x: NDArray[Any]) -> NDArray[Any]:
    """Steps (M, 2, rows, cols) of pictures to the next row and column; 0 from the last ones."""
    result = np.zeros((len(x), 2, *x.shape[1:]), x.dtype)
    np.subtract(x[:, 1:], x[:, :-1], out=result[:, 0, :-1])
    np.subtract(x[:, :, 1:], x[:, :, :-1], out=result[:, 1, :, :-1])
    return result


def adjoint(g: NDArray[Any]) -> NDArray[Any]:
    """The adjoint of `differences`, (M, rows, cols)."""
    down, right = g[:, 0, :-1], g[:, 1, :, :-1]
    x = np.zeros((len(g), *g.shape[2:]), g.dtype)
    x[:, 1:] += down
    x[:, :-1] -= down
    x[:, :, 1:] += right
    x[:, :, :-1] -= right
    return x


def _filtered(pictures: NDArray[Any]) -> NDArray[Any]:
    """(2 I + D' D)^-1 of pictures: D' D is diagonal under the cosine transform."""
    rows, cols = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in pictures.shape[1:])
    spectrum = scipy.fft.dctn(pictures, axes=(1, 2), norm="ortho")
    spectrum /= (2 + rows[:, None] + cols).astype(pictures.dtype)
    return np.asarray(scipy.fft.idctn(spectrum, axes=(1, 2), norm="ortho", overwrite_x=True))


def _flat(rows: NDArray[Any]) -> NDArray[Any]:
    return rows.reshape(len(rows), -1)
