"""The background of coherent estimates: faint light from everywhere, more of it from nearby.

A row's sparse part holds the pixels that it sees well. The rest of the light is spread widely, but
not evenly: light that comes by way of another surface falls off with its distance. So a row has one
unpenalised coefficient for a halo around its sparse part, and penalised coefficients of coarse
cells of projector pixels for light that differs from the halo.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.computed_once import computed_once
from lightmatrix.solvers.weighted import Cells
from lightmatrix.transport.matrix import cell_means
from lightmatrix.transport.sparse_rows import SparseRows

# The penalty of a cell's coefficient is this share of the clip level over the side of the cell in
# pixels. Three times as much or as little changes errors by about a tenth (docs/few-patterns.md).
CELL_PENALTY = 0.05
# Halos are computed on at most this many squares along the projector's longer side. Chosen by hand:
# halos are smooth.
SQUARES = 128
# At a distance of d the halo is 1 / (d^2 + c^2)^2, as the light of a patch in front of a wall at a
# distance of c. This is c as a share of the projector's longer side. Measured on `l_objects` at 64
# mixed patterns: rows of mostly global light err by .129, and by .135 with c = 2 squares, which
# makes halos too narrow nearby and too bright far away.
WALL = 1 / 8


@dataclass(frozen=True)
class Backgrounds:
    """B coarse cells of projector pixels, their means under all patterns, and halos on them."""

    grid: tuple[int, int]
    shown: PatternSet
    unseen: PatternSet

    def spread(self, rows: csr_array) -> NDArray[np.float32]:
        """The shares of the halo of each row (m, N) in the cells, (m, B); even if it is empty."""
        squares = csr_array(
            (rows.data, self._square[rows.indices], rows.indptr), self._squares_shape(rows)
        )
        shares = np.asarray(squares @ self._halos)
        total = shares.sum(axis=1, keepdims=True)
        even = (self._sizes / self._sizes.sum()).astype(np.float32)
        return np.where(total > 0, shares / np.where(total > 0, total, 1), even)

    def under_patterns(self, shares: NDArray[np.float32]) -> NDArray[np.float32]:
        """The halos under the patterns, shown and unseen, (m, K + E) in [0, 1]."""
        under = _core.rows_times(shares, self._means)
        return np.clip(under, 0, 1, out=under)

    def cells(self, cost: float, *, unseen: bool) -> Cells:
        """The cells as columns; `cost` is the clip level over the regularization."""
        if self.grid == (1, 1):
            return Cells.none(self.shown, self.unseen if unseen else None)
        penalties = CELL_PENALTY * cost / np.sqrt(self._sizes)
        count = None if unseen else self.shown.count
        return Cells(np.ascontiguousarray(self._means[:, :count]), penalties.astype(np.float32))

    @property
    def shown_means(self) -> NDArray[np.float32]:
        """Mean of each pattern shown over each cell, (B, K) in [0, 1]."""
        return self._means[:, : self.shown.count]

    def lengths(self, rows: SparseRows) -> NDArray[np.float64]:
        """Euclidean norm of each row of pixels and cells, (m,), as if they did not overlap."""
        squares = rows.coefficients.multiply(rows.coefficients).sum(axis=1)
        spread = (rows.background.astype(np.float64) ** 2) @ (1 / self._sizes)
        return np.sqrt(np.asarray(squares, np.float64).ravel() + spread)

    @property
    def brightness(self) -> NDArray[np.float64]:
        """Mean of each pattern shown, (K,) in [0, 1]."""
        return np.asarray(self._sizes @ self.shown_means / self._sizes.sum(), np.float64)

    @computed_once
    def _pooling(self) -> csr_array:
        return cell_means(self.shown.shape, self.grid)

    @computed_once
    def _sizes(self) -> NDArray[np.float64]:
        return np.asarray(np.diff(self._pooling.indptr), np.float64)

    @computed_once
    def _means(self) -> NDArray[np.float32]:
        """Mean of each pattern over each cell, (B, K + E) in [0, 1]."""
        parts = [
            self._pooling @ chunk.T
            for one in (self.shown, self.unseen)
            for _, chunk in one.chunks()
        ]
        return np.clip(np.concatenate(parts, axis=1), 0, 1).astype(np.float32)

    @computed_once
    def _square(self) -> NDArray[np.int64]:
        """The square of each pixel, (N,)."""
        return _square_of_each(self.shown.shape)

    def _squares_shape(self, rows: csr_array) -> tuple[int, int]:
        down, right = _squares(self.shown.shape)
        return rows.shape[0], down * right

    @computed_once
    def _halos(self) -> NDArray[np.float32]:
        """The light of each cell in the halo around each square, (squares, B)."""
        return _halos(self.shown.shape, self.grid)


def _side(shape: tuple[int, int]) -> int:
    """Side of a square in pixels."""
    return -(-max(shape) // SQUARES)


def _squares(shape: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of squares of a projector."""
    return -(-shape[0] // _side(shape)), -(-shape[1] // _side(shape))


def _square_of_each(shape: tuple[int, int]) -> NDArray[np.int64]:
    """The square of each pixel, (N,)."""
    r, c = np.indices(shape) // _side(shape)
    return np.asarray(r * _squares(shape)[1] + c).ravel()


# The estimate of a capture begins with estimates of a part of it, of the same projector.
@lru_cache(maxsize=2)
def _halos(shape: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.float32]:
    """The light of each of the B cells of a grid in the halo around each square, (squares, B)."""
    (rows, cols), square = _squares(shape), _square_of_each(shape)
    down, right = np.ogrid[1 - rows : rows, 1 - cols : cols]
    kernel = 1 / (down**2 + right**2 + (WALL * max(rows, cols)) ** 2) ** 2
    # Convolution by scipy.fft, as importing scipy.signal takes a second.
    sides = zip(kernel.shape, (rows, cols), strict=True)
    fast = [next_fast_len(n + m - 1, True) for n, m in sides]
    spread = rfft2(kernel, fast)
    pooling = cell_means(shape, grid)
    result = np.empty((rows * cols, pooling.shape[0]), np.float32)
    for cell, (first, last) in enumerate(pairwise(pooling.indptr)):
        # The number of the cell's pixels in each square.
        counts = np.bincount(square[pooling.indices[first:last]], minlength=rows * cols)
        light = irfft2(rfft2(counts.reshape(rows, cols), fast) * spread, fast)
        near = light[rows - 1 : 2 * rows - 1, cols - 1 : 2 * cols - 1]
        result[:, cell] = np.maximum(near, 0).ravel()
    result.setflags(write=False)
    return result
