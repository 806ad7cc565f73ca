"""A coarse T, by which a whole pattern is relit at once while the fine one takes its time."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.transport.matrix import cell_means
from lightmatrix.viewer.lights import Light

# Squares of camera pixels along the longer side, and cells of the projector. Chosen by hand: a
# picture of so many squares is recognized, and the coarse T of a megapixel takes a few megabytes.
_SQUARES, _CELLS = 128, 64
# Entries that are added up at a time, so that strokes meanwhile wait for a few milliseconds.
_PART = 1 << 20


class CoarseLight:
    """T with squares of camera pixels averaged and cells of projector pixels added up.

    Made once, from all of T. With a colour camera, channels stay apart.
    """

    def __init__(self, light: Light) -> None:
        matrix = light.matrix
        rows, cols = matrix.camera_shape[:2]
        self.block = math.ceil(max(rows, cols) / _SQUARES)
        self.shape = (math.ceil(rows / self.block), math.ceil(cols / self.block), light.channels)
        height, width = matrix.projector_shape
        grid = (min(_CELLS, height), min(_CELLS, width))
        cell_of = grid_cells(matrix.projector_shape, grid)
        self._means = cell_means(matrix.projector_shape, grid)
        squares = self._squares(np.arange(matrix.shape[0]), cols)
        count = math.prod(self.shape)
        sizes = np.bincount(squares, minlength=count)
        self._matrix = csr_array((count, self._means.shape[0]), dtype=np.float32)
        self._background = np.zeros((count, matrix.pooling.shape[0]), np.float32)
        self._pooling = matrix.pooling
        blocks = light.blocks()
        while True:
            with light.lock:
                start, block = next(blocks, (0, None))
            if block is None:
                break
            square = squares[start : start + block.count]
            np.add.at(self._background, square, block.background / sizes[square, None])
            entries = block.coefficients
            owner = np.repeat(square, np.diff(entries.indptr))
            for low, high in itertools.pairwise([*range(0, entries.nnz, _PART), entries.nnz]):
                part = slice(low, high)
                place = (owner[part], cell_of[entries.indices[part]])
                values = entries.data[part] / sizes[owner[part]].astype(np.float32)
                self._matrix = self._matrix + coo_array((values, place), self._matrix.shape).tocsr()

    def image(self, change: NDArray[np.float32]) -> NDArray[np.float32]:
        """The light of a change (N,) of the pattern, coarse: (rows, cols, channels)."""
        # A pattern that is constant in each cell gets exactly the means of its light.
        light = self._matrix @ (self._means @ change) + self._background @ (self._pooling @ change)
        return np.asarray(light, np.float32).reshape(self.shape)

    def spread(self, image: NDArray[np.float32], rows: int, cols: int) -> NDArray[np.float32]:
        """A coarse image with a value for each camera pixel."""
        wide = np.repeat(np.repeat(image, self.block, axis=0), self.block, axis=1)
        return wide[:rows, :cols]

    def _squares(self, samples: NDArray[np.integer], cols: int) -> NDArray[np.int64]:
        """The square and channel that each camera sample belongs to."""
        pixels, channel = np.divmod(samples, self.shape[2])
        row, col = np.divmod(pixels, cols)
        square = row // self.block * self.shape[1] + col // self.block
        return np.asarray(square * self.shape[2] + channel, np.int64)
