"""Rows that are pictures, such as those of a single-pixel camera: least total variation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dctn, idctn
from scipy.sparse import csr_array

from lightmatrix.solvers.admm import System, relative
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.loop import Progress
from lightmatrix.solvers.problem import Floats, Problem, Result, Status, objective, solved_rows


@dataclass(frozen=True)
class TotalVariation:
    """min_x regularization * TV(x) + sum_k w_k f_k(a_k . x), with x >= 0 if `nonnegative`.

    TV is the sum over pixels of the length of the differences to the pixel below and to the right
    (Rudin, Osher and Fatemi 1992). It leaves an even background free, so that the problem's has no
    coefficient of its own. ADMM with u = P x, x = z, s = D z and v = z, v >= 0 alternates between
    (x, s, v) and (z, u) (Afonso, Bioucas-Dias and Figueiredo 2011). Rows stop together.
    """

    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    max_iterations: int = 1000
    tolerance: float = 1e-4

    def solve(self, problem: Problem, progress: Progress | None = None) -> Result:
        """Solve all rows; `progress` is called at the end."""
        patterns, values, shape = problem.patterns, problem.samples.values, problem.patterns.shape
        update = Fidelity(self.fidelity).term.update
        observed, u = problem.observed.astype(np.float64), values.astype(np.float64)
        # Twice to four times the penalty over a typical pixel converges fastest, whatever the unit.
        level = float(np.abs(values).sum() / (max(len(values), 1) * patterns.sums.sum()))
        system = System(patterns, 3 * problem.regularization / max(level, 1e-30), None)
        z = x_dual = v_dual = np.zeros((len(values), patterns.pixels))
        u_dual, s_dual = np.zeros(values.shape), _slopes(z, shape)
        steps = np.zeros(len(values), np.int32)
        for _ in range(self.max_iterations):
            steps += 1
            x, samples = system.solve(u - u_dual, z - x_dual)
            # Slopes get shorter by the penalty, whatever their direction.
            s = _slopes(z, shape) + s_dual
            length = np.maximum(np.sqrt(np.square(s).sum(axis=1, keepdims=True)), 1e-300)
            s *= np.maximum(1 - problem.regularization / system.ridge / length, 0)
            v = np.maximum(z + v_dual, 0) if problem.nonnegative else z + v_dual
            # (2 + D' D) z = x + x_dual + v - v_dual + D' (s - s_dual).
            before, z = z, _solve(x + x_dual + v - v_dual + _adjoint(s - s_dual), shape)
            u = update(samples + u_dual, observed, 1.0)
            x_dual, v_dual, u_dual = x_dual + x - z, v_dual + z - v, u_dual + samples - u
            s_dual = s_dual + _slopes(z, shape) - s
            off = np.maximum(relative(x - v, 1e-30, x, v), relative(z - before, 1e-30, z, before))
            if (off <= self.tolerance).all():
                break
        rows, none = csr_array(v.astype(values.dtype)), np.zeros(len(v), values.dtype)
        # The data term, beside which this l1 norm is nothing, and the total variation.
        total = objective(replace(problem, regularization=1e-300), rows, none, self.fidelity)
        total += problem.regularization * np.sqrt(np.square(_slopes(v, shape)).sum(1)).sum((1, 2))
        converged = off <= self.tolerance
        status = Status.CONVERGED if converged.all() else Status.ITERATION_LIMIT
        if progress is not None:
            progress(len(v), len(v))
        done = solved_rows(rows, none, iterations=steps, converged=converged, objective=total)
        return Result(done, status)

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: a step in double precision."""
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
