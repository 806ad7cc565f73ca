"""The x-update's linear system, factored once for all camera samples (Eq. 10 and 17).

Unknowns of a row are its N pixels and, if the problem has a background, one coefficient of the
pattern means m. That coefficient is kept in units in which its column is as long as the sum of all
pixel columns, `scale * m`: so the direction in which 0/1 patterns are nearly all alike is cheap to
move in, and single precision suffices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns import PatternSet


@dataclass(frozen=True, eq=False)
class System:
    """Regularized least squares with A = diag(row_scale) [P, scale m].

    Parameters
    ----------
    patterns : PatternSet
        P, (K, N).
    ridge : float
        > 0.
    background : bool
        Whether the column of the means is there.
    row_scale : (K,) float64, optional
        Square roots of the patterns' weights; None means 1.
    """

    patterns: PatternSet
    ridge: float
    background: bool
    row_scale: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        patterns = self.patterns
        # frozen: the factor is part of what the system is, made once here, in double precision.
        object.__setattr__(self, "scale", float(np.sqrt(patterns.pixels)))
        means = patterns.means * (self.scale if self.background else 0.0)
        rows = np.ones(patterns.count) if self.row_scale is None else self.row_scale
        wide = patterns.count <= patterns.pixels
        object.__setattr__(self, "_wide", wide)
        if wide:
            square = (patterns.gram + np.outer(means, means)) * np.outer(rows, rows)
        else:
            matrix = np.column_stack([patterns.dense().astype(np.float64), means])
            matrix = matrix if self.background else matrix[:, :-1]
            matrix *= rows[:, None]
            square = matrix.T @ matrix
        square = square + self.ridge * np.eye(square.shape[-1])
        # The explicit inverse turns every later solve into one matrix product; in double precision
        # its error is far below that of the single-precision products around it.
        object.__setattr__(self, "_inverse", np.linalg.inv(square))

    scale: float = 0.0

    @property
    def unknowns(self) -> int:
        """N, or N + 1 with a background."""
        return self.patterns.pixels + int(self.background)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        """A x for rows x of (M, unknowns): (M, K)."""
        samples = self.patterns.forward(x[:, : self.patterns.pixels])
        if self.background:
            means = (self.scale * self.patterns.means).astype(x.dtype)
            samples += np.multiply.outer(x[:, -1], means)
        if self.row_scale is not None:
            samples *= self.row_scale.astype(x.dtype)
        return samples

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        """A' e for rows e of (M, K): (M, unknowns)."""
        if self.row_scale is not None:
            e = e * self.row_scale.astype(e.dtype)
        result = np.empty((len(e), self.unknowns), e.dtype)
        result[:, : self.patterns.pixels] = self.patterns.adjoint(e)
        if self.background:
            result[:, -1] = e @ (self.scale * self.patterns.means).astype(e.dtype)
        return result

    def solve(self, target: NDArray[Any], point: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """argmin_x ||A x - target||^2 + ridge ||x - point||^2, and its prediction A x.

        This is (A' A + ridge I)^-1 (A' target + ridge point). By the matrix inversion lemma it is
        point + A' t with t = (A A' + ridge I)^-1 (target - A point), whose prediction is
        target - ridge t: one product with A and one with A', and no difference of large numbers,
        so that single precision suffices.

        Parameters
        ----------
        target : (M, K)
        point : (M, unknowns)
            The results have its dtype.
        """
        dtype = point.dtype
        if self._wide:
            distance = (target - self.forward(point)).astype(np.float64)
            t = _each_by(distance, self._inverse)
            prediction = target - (self.ridge * t).astype(dtype)
            return point + self.adjoint(t.astype(dtype)), prediction
        right = self.adjoint(target.astype(np.float64)) + self.ridge * point.astype(np.float64)
        x = _each_by(right, self._inverse).astype(dtype)
        return x, self.forward(x)

    _wide: bool = True
    _inverse: Any = None


def _each_by(rows: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows times one matrix, or equal groups of rows times a matrix each."""
    if matrix.ndim == 2:
        return rows @ matrix
    return (rows.reshape(len(matrix), -1, rows.shape[1]) @ matrix).reshape(rows.shape)
