"""A matrix that stays on disk: rows, columns, regions and relighting without loading all of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import as_damage_error
from lightmatrix.ranges import real_array
from lightmatrix.resources.memory import check_memory
from lightmatrix.store.matrix_checks import (
    check_indptr,
    checked_diagnostics,
    checked_float32,
    checked_matrix,
)
from lightmatrix.store.zarr_store import RESTORE, StoreHeader, read_store_header, read_whole
from lightmatrix.transport.matrix import (
    LightTransport,
    cell_means,
    check_lights,
    checked_patterns,
)
from lightmatrix.transport.operator import TransportOperator
from lightmatrix.transport.sparse_rows import SparseRows, row_blocks

# Entries of T in a block of rows: eight chunks, so that few chunks are read twice because a block
# ends within them.
_BLOCK_ENTRIES = 1 << 23
# Bytes of blocks that are kept once they were read. Chosen by hand.
KEPT = 1 << 30


@dataclass(frozen=True, eq=False)
class StoredTransport(TransportOperator):
    """A light transport matrix on disk, of which as much is read as is asked for.

    Made by `open`. Blocks of rows that were read are kept, up to a gigabyte, so that a matrix that
    fits is decompressed once.

    Parameters
    ----------
    header : StoreHeader
        What the store announces.
    memory : int
        Bytes of blocks that are kept.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("lazy.zarr", lm.truth("metal").transport())
    >>> stored = lm.StoredTransport.open("lazy.zarr")
    >>> stored.relight(np.ones(stored.projector_shape)).shape, stored.row(20, 30).shape
    ((64, 64), (64, 64))
    >>> stored.region(slice(8, 16), slice(0, 64))
    LightTransport(camera 8 x 64, projector 64 x 64, 214586 entries, metal)
    """

    header: StoreHeader
    memory: int = KEPT
    _kept: dict[int, SparseRows] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        camera, projector = (
            " x ".join(map(str, shape)) for shape in (self.camera_shape, self.projector_shape)
        )
        return (
            f"StoredTransport({self.header.place}, camera {camera}, projector {projector}, "
            f"{self.entries} entries)"
        )

    @classmethod
    def open(cls, path: str | Path, *, memory: int = KEPT) -> Self:
        """Open a store, reading no more than where its rows begin.

        Parameters
        ----------
        path : str or Path
            A .zarr folder from `estimate` or `save`.
        memory : int
            Bytes of blocks that are kept once they were read.

        Raises
        ------
        InputError
            If there is none, it is incomplete, damaged, or of a later format version. Rows are
            checked when they are read, and a damaged chunk is named then.
        """
        matrix = cls(read_store_header(path), memory)
        check_memory(matrix.header.place, matrix.header.arrays["indptr"].bytes)
        # Read now, so that damage of it is reported at once.
        assert len(matrix._indptr) > 0
        return matrix

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels)."""
        return self.header.camera_shape

    @property
    def projector_shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.header.projector_shape

    @property
    def background_grid(self) -> tuple[int, int]:
        """Rows and columns of the background's grid."""
        return self.header.background_grid

    @property
    def provenance(self) -> Mapping[str, Any]:
        """What the matrix was made from, and how."""
        return self.header.provenance

    @property
    def shape(self) -> tuple[int, int]:
        """Camera samples and projector pixels (M, N)."""
        return self.header.shape

    @property
    def image_shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The shapes of the camera and of the projector."""
        return self.camera_shape, self.projector_shape

    @property
    def entries(self) -> int:
        """Entries of the sparse part."""
        return int(self._indptr[-1])

    @cached_property
    def pooling(self) -> csr_array:
        """The operator m: mean over each cell of the background grid, (B, N)."""
        return cell_means(self.projector_shape, self.background_grid)

    def rows(self, start: int, stop: int) -> SparseRows:
        """The camera samples start to stop, with diagnostics, read from their chunks alone.

        Parameters
        ----------
        start, stop : int
            0 <= start <= stop <= M.

        Raises
        ------
        InputError
            If there are no such rows, or naming a chunk that is damaged.
        """
        if not 0 <= start <= stop <= self.shape[0]:
            raise InputError(
                f"rows {start} to {stop} of a matrix of {self.shape[0]}", hint="ask for its rows"
            )
        arrays = self.header.diagnostics
        with self.header.unreplaced(), as_damage_error(self.header.place, RESTORE):
            read = {name: array.read(slice(start, stop)) for name, array in arrays.items()}
            diagnostics = checked_diagnostics(read, stop - start)
        return replace(self._rows(start, stop), diagnostics=diagnostics)

    def _rows(self, start: int, stop: int) -> SparseRows:
        """Rows without their diagnostics, which images do not need."""
        arrays = self.header.arrays
        ends = self._indptr[start : stop + 1]
        entries = slice(int(ends[0]), int(ends[-1]))
        with self.header.unreplaced(), as_damage_error(self.header.place, RESTORE):
            matrix = checked_matrix(
                arrays["data"].read(entries),
                arrays["indices"].read(entries),
                ends - ends[0],
                (stop - start, self.shape[1]),
            )
        return SparseRows(matrix, self.background(start, stop))

    def background(self, start: int, stop: int) -> NDArray[np.float32]:
        """Some rows of the background, (stop - start, B) float32."""
        with self.header.unreplaced(), as_damage_error(self.header.place, RESTORE):
            values = self.header.arrays["background"].read(slice(start, stop))
            return checked_float32(values, "background")

    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        """All rows in blocks of bounded size, without diagnostics: (first row, rows)."""
        for start, stop in zip(self._cuts[:-1], self._cuts[1:], strict=True):
            yield int(start), self._block(int(start), int(stop))

    def region(self, rows: slice, cols: slice) -> LightTransport:
        """A rectangle of the camera's pixels as a matrix in memory.

        Parameters
        ----------
        rows, cols : slice
            With start and stop within the camera and without step.

        Raises
        ------
        InputError
            If it is empty or leaves the camera.
        """
        height, width, *channels = self.camera_shape
        for part, size in ((rows, height), (cols, width)):
            if part.step not in (None, 1) or not 0 <= part.start < part.stop <= size:
                raise InputError(
                    f"a region of {rows.start}:{rows.stop}, {cols.start}:{cols.stop} of a camera "
                    f"of {height} x {width}",
                    hint="name rows and columns that it has",
                )
        depth = math.prod(channels)
        lines = [
            self.rows((r * width + cols.start) * depth, (r * width + cols.stop) * depth)
            for r in range(rows.start, rows.stop)
        ]
        region = SparseRows.joined(lines)
        return LightTransport(
            region.coefficients,
            region.background,
            (rows.stop - rows.start, cols.stop - cols.start, *channels),
            self.projector_shape,
            self.background_grid,
            region.diagnostics,
            self.provenance,
        )

    def load(self) -> LightTransport:
        """All of it in memory, as `lightmatrix.open` returns it."""
        return read_whole(self.header)

    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """T p for (N, k) vectors, read block by block."""
        pooled = self.pooling @ vectors
        light = np.empty((self.shape[0], vectors.shape[1]), vectors.dtype)
        for start, block in self.blocks():
            part = block.coefficients @ vectors + block.background @ pooled
            light[start : start + block.count] = part
        return light

    def multiplied_transposed(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """T' c for (M, k) vectors, read block by block."""
        image = np.zeros((self.shape[1], vectors.shape[1]), vectors.dtype)
        diffuse = np.zeros((math.prod(self.background_grid), vectors.shape[1]), vectors.dtype)
        for start, block in self.blocks():
            part = vectors[start : start + block.count]
            image += block.coefficients.T @ part
            diffuse += block.background.T @ part
        return np.asarray(image + self.pooling.T @ diffuse)

    def relight(self, patterns: NDArray[Any]) -> NDArray[np.float32]:
        """Camera images under patterns; see `LightTransport.relight`."""
        stack = checked_patterns(patterns, self.projector_shape)
        light = self.multiplied(stack.reshape(-1, self.shape[1]).T)
        images = np.asarray(light.T, np.float32).reshape(-1, *self.camera_shape)
        return images if stack.ndim == 3 else images[0]

    def dual(self, lights: NDArray[Any]) -> NDArray[np.float32]:
        """The scene seen from the projector; see `LightTransport.dual`."""
        light = np.asarray(real_array("camera lights", lights), np.float32)
        if light.shape != self.camera_shape:
            raise InputError(
                f"camera lights of shape {light.shape}", hint=f"give shape {self.camera_shape}"
            )
        check_lights(lights)
        image = self.multiplied_transposed(light.reshape(-1, 1).astype(np.float64))
        return image.astype(np.float32).reshape(self.projector_shape)

    def row(self, *camera_index: int) -> NDArray[np.float32]:
        """How each projector pixel reaches one camera sample, as a projector image."""
        index = self.row_number(camera_index)
        row = self._rows(index, index + 1)
        values = row.coefficients.toarray() + row.background @ self.pooling
        return np.asarray(values, np.float32).reshape(self.projector_shape)

    def column(self, row: int, col: int) -> NDArray[np.float32]:
        """The camera image when one projector pixel is lit."""
        index = self.column_number(row, col)
        return self.dense_columns(np.array([index]))[:, 0].reshape(self.camera_shape)

    def dense_columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        """Chosen columns of T, background included: (M, len(index)) float32."""
        pooled = self.pooling[:, index].toarray()
        columns = np.empty((self.shape[0], len(index)), np.float32)
        for start, block in self.blocks():
            values = block.coefficients[:, index].toarray() + block.background @ pooled
            columns[start : start + block.count] = values
        return columns

    @cached_property
    def _indptr(self) -> NDArray[np.int64]:
        with self.header.unreplaced(), as_damage_error(self.header.place, RESTORE):
            indptr = self.header.arrays["indptr"].read()
            check_indptr(indptr, self.header.arrays["data"].shape[0])
        return indptr.astype(np.int64)

    @cached_property
    def _cuts(self) -> NDArray[np.int64]:
        """First rows of the blocks, and M."""
        return row_blocks(self._indptr, _BLOCK_ENTRIES)

    def _block(self, start: int, stop: int) -> SparseRows:
        kept = self._kept.get(start)
        if kept is not None:
            return kept
        block = self._rows(start, stop)
        # The first blocks stay: going through all blocks in order, replacing the oldest would
        # always remove the one that is needed next.
        if sum(map(_bytes, self._kept.values())) + _bytes(block) <= self.memory:
            self._kept[start] = block
        return block


def _bytes(rows: SparseRows) -> int:
    matrix = rows.coefficients
    parts = (matrix.data, matrix.indices, matrix.indptr, rows.background)
    return sum(part.nbytes for part in parts)
