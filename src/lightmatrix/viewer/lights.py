"""T where Python keeps it, for matrices that the page does not hold: on disk, or in memory."""

import itertools
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.transport.column_index import COLUMNS, ColumnIndex, index_columns
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows, row_blocks
from lightmatrix.transport.store import StoredTransport

Singles = NDArray[np.float32]

# Called with what is done, all there is, and a note.
StageProgress = Callable[[int, int, str], None]
# Bytes of rows that are kept once they were read: with the index, which keeps as much, and a few
# images, the server stays below 1 GiB.
_KEPT_BYTES = 256 << 20
# Entries of a block of rows in memory.
_BLOCK_ENTRIES = 1 << 22
# Groups of rows, spread over the camera, from which the white level is estimated.
_SAMPLED_GROUPS, _GROUP_ROWS = 16, 4096


class Light(ABC):
    """T as a session asks for it; several threads may."""

    matrix: LightTransport | StoredTransport

    @abstractmethod
    def columns(self, pixels: NDArray[np.integer], change: NDArray[np.floating]) -> Singles:
        """The light of some projector pixels that get brighter, of the camera's shape."""

    @abstractmethod
    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        """All rows in blocks: (first row, rows)."""

    @property
    def channels(self) -> int:
        """Samples of a camera pixel."""
        return math.prod(self.matrix.camera_shape[2:])

    def row(self, row: int, col: int) -> Singles:
        """The row of a camera pixel, its channels added, of the projector's shape."""
        first = (row * self.matrix.camera_shape[1] + col) * self.channels
        rows = self.matrix.some_rows(first, first + self.channels)
        light = np.asarray(rows.coefficients.sum(axis=0)) + rows.background.sum(axis=0) @ (
            self.matrix.pooling
        )
        return np.asarray(light, np.float32).reshape(self.matrix.projector_shape)

    def white_samples(self) -> Singles:
        """What some camera samples, spread over the camera, see of a white pattern."""
        count = self.matrix.shape[0]
        starts = np.linspace(0, count, _SAMPLED_GROUPS, endpoint=False).astype(int).tolist()
        parts = []
        for start, following in itertools.pairwise([*starts, count]):
            rows = self.matrix.some_rows(start, min(start + _GROUP_ROWS, following))
            parts.append(rows.coefficients.sum(axis=1) + rows.background.sum(axis=1))
        return np.concatenate(parts).astype(np.float32)

    @property
    @abstractmethod
    def facts(self) -> LightTransport:
        """A matrix with the diagnostics of T, whose sparse part may be empty."""


class StoredLight(Light):
    """T on disk, with an index of its columns."""

    def __init__(self, matrix: StoredTransport) -> None:
        self.matrix: StoredTransport = matrix
        self._index = ColumnIndex.open(matrix.place)
        # The index keeps what it has read.
        self._lock = threading.Lock()

    @classmethod
    def open(cls, path: str | Path, progress: StageProgress | None = None) -> "StoredLight":
        """Open a store; without an index, make it."""
        matrix = StoredTransport.open(path, memory=_KEPT_BYTES)
        if not (matrix.place / COLUMNS).is_dir():
            background = matrix.arrays["background"].bytes
            size = 8 * (matrix.entries + matrix.shape[1]) + background
            note = f"at most {max(1, size >> 20)} MiB beside the matrix"
            told = progress or (lambda *_: None)
            index_columns(path, progress=lambda done, total: told(done, total, note))
            # Its metadata was written anew.
            matrix = StoredTransport.open(path, memory=_KEPT_BYTES)
        return cls(matrix)

    def columns(self, pixels: NDArray[np.integer], change: NDArray[np.floating]) -> Singles:
        with self._lock:
            return self._index.light(pixels, change)

    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        return self.matrix.blocks()

    @property
    def facts(self) -> LightTransport:
        matrix = self.matrix
        empty = csr_array(matrix.shape, dtype=np.float32)
        known = matrix.diagnostics(0, matrix.shape[0])
        camera, projector = matrix.camera_shape, matrix.projector_shape
        return LightTransport.from_matrix(empty, camera, projector, diagnostics=known)


class MemoryLight(Light):
    """T in memory, which is copied column by column."""

    def __init__(self, matrix: LightTransport) -> None:
        self.matrix: LightTransport = matrix
        self._by_columns = csc_array(matrix.sparse)
        self._cells = grid_cells(matrix.projector_shape, matrix.background_grid)
        self._cell_sizes = np.bincount(self._cells)

    def columns(self, pixels: NDArray[np.integer], change: NDArray[np.floating]) -> Singles:
        cells = self._cells[pixels]
        means = np.bincount(cells, change / self._cell_sizes[cells], len(self._cell_sizes))
        light = self._by_columns[:, pixels] @ change.astype(np.float32)
        light = light + self.matrix.background @ means.astype(np.float32)
        return np.asarray(light, np.float32).reshape(self.matrix.camera_shape)

    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        cuts = row_blocks(self.matrix.sparse.indptr, _BLOCK_ENTRIES)
        for start, stop in itertools.pairwise(cuts.tolist()):
            yield start, self.matrix.some_rows(start, stop)

    @property
    def facts(self) -> LightTransport:
        return self.matrix
