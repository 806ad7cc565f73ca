"""The linear system of the x-update, factored once for all camera samples (Eq. 10 and 17).

The unknowns of a row are its N pixels and, with a background, one more: c = sum x + b, the response
to an all-white pattern. In x and c the prediction is

    P x + b m = (P - m 1') x + c m,

so pixels act through the centred patterns only. That removes the direction in which all columns of
0/1 patterns are alike, whose eigenvalue is about N times as large as the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.pattern_set import PatternSet
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
    """Rows times one matrix, or equal groups of rows times one matrix each."""
    if matrix.ndim == 2:
        return rows @ matrix
    return (rows.reshape(len(matrix), -1, rows.shape[1]) @ matrix).reshape(rows.shape)
