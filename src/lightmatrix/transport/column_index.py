"""An index of the columns of a store, so that a brush stroke reads no more than its columns.

A store is cut into rows, and a column is spread over all of them. The index keeps the entries a
second time: it is a store of the transposed matrix within the store. Its rows are the columns of
the projector pixels, those of 16 x 16 pixels together, and then those of the background's cells.
"""

import itertools
import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import STORE
from lightmatrix.files.writing import claimed, temporary
from lightmatrix.files.zarr_arrays import QUICK
from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.progress import Progress
from lightmatrix.reprs import ShortRepr
from lightmatrix.resources.memory import check_disk_space
from lightmatrix.transport.sparse_rows import row_blocks
from lightmatrix.transport.store import StoredTransport, fill_store

# The folder of an index within a store.
COLUMNS = "columns"
# Entries that are transposed at once. Each takes 8 bytes, and 8 more while they are joined.
_PASS_ENTRIES = 1 << 26
# Rows and columns of projector pixels whose columns stand together, and are read together.
_TILE = 16
# Entries of a chunk of the index: few, so that the pixels of a brush read little else.
_CHUNK = 1 << 16
# Entries that an index keeps in memory, 8 bytes each.
_KEPT_ENTRIES = 1 << 24
_REMEDY = "make it again with index_columns"


def index_columns(
    path: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> None:
    """Add an index of its columns to a matrix on disk.

    The index takes about as much disk space as the matrix, and at most 1.5 GB of memory.

    Parameters
    ----------
    path : str or Path
        A .zarr folder from `estimate` or `save`.
    overwrite : bool
        Whether an index that exists already is made again.
    progress : callable, optional
        Called with (done, total) entries; each is read twice or more often.

    Raises
    ------
    InputError
        If there is no matrix, it is damaged, or has an index already.
    OutputError
        If it is being written, was changed by others, or the disk is full or fails.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("brush.zarr", lm.truth("metal").transport())
    >>> lm.index_columns("brush.zarr")
    >>> stroke = lm.ColumnIndex.open("brush.zarr").light(np.arange(2080, 2090), np.ones(10))
    >>> stroke.shape
    (64, 64)
    """
    matrix = StoredTransport.open(path, memory=0)
    with claimed(path, STORE, overwrite=True) as target, temporary(path, target) as place:
        if (target / COLUMNS).exists() and not overwrite:
            raise InputError(f"{path}: has an index already", hint="pass overwrite=True")
        background = 2 * matrix.arrays["background"].bytes
        check_disk_space(target, 8 * matrix.entries + 8 * matrix.shape[1] + background, path)
        _write_index(place / "new", matrix, progress or (lambda done, total: None))
        shutil.rmtree(target / COLUMNS, ignore_errors=True)
        os.rename(place / "new", target / COLUMNS)
        STORE.mark(target)


def tile_places(pixels: NDArray[np.integer], projector_shape: tuple[int, int]) -> NDArray[np.int64]:
    """Places 0 to N - 1 of projector pixels in the index: by tiles of 16 x 16, row by row.

    The pixels of a brush, which lie beside and below each other, then stand together.
    """
    rows, cols = projector_shape
    row, col = np.divmod(pixels, cols)
    top, left = row - row % _TILE, col - col % _TILE
    height, width = np.minimum(_TILE, rows - top), np.minimum(_TILE, cols - left)
    # Pixels in the rows of tiles above, in the tiles to the left, and before it in its own tile.
    return top * cols + left * height + (row - top) * width + col - left


def _write_index(part: Path, matrix: StoredTransport, progress: Progress) -> None:
    """Write the transposed matrix, its rows in the order of `tile_places`, in bounded memory."""
    samples, pixels = matrix.shape
    cells = math.prod(matrix.background_grid)
    order = np.argsort(tile_places(np.arange(pixels), matrix.projector_shape))
    # One reading to count, and one for each pass.
    total = matrix.entries * (1 + max(1, math.ceil(matrix.entries / _PASS_ENTRIES)))
    done = 0

    def blocks() -> Iterator[csr_array]:
        nonlocal done
        for _, block in matrix.blocks():
            yield block.coefficients
            done += block.coefficients.nnz
            progress(min(done, total), total)

    def arrays(ends: NDArray[Any], rows: csr_array) -> dict[str, NDArray[Any]]:
        # No row has a background of its own.
        nothing = np.zeros((rows.shape[0], 1), np.float32)
        indices = rows.indices.astype(np.int32, copy=False)
        return {"indptr": ends, "indices": indices, "data": rows.data, "background": nothing}

    def parts() -> Iterator[dict[str, NDArray[Any]]]:
        counts = sum(np.bincount(block.indices, minlength=pixels)[order] for block in blocks())
        ends = np.concatenate([[0], np.cumsum(counts)])
        for first, last in itertools.pairwise(row_blocks(ends, _PASS_ENTRIES)):
            some = order[first:last]
            rows = hstack([block[:, some].T.tocsr() for block in blocks()], format="csr")
            # The first row's beginning is that of the array as well.
            yield arrays(ends[first + 1 if first else 0 : last + 1], rows)
        end = ends[-1:]
        for cell in range(cells):
            light = matrix.arrays["background"].read(slice(None), slice(cell, cell + 1))
            # Samples without background have no entry.
            row = csr_array(light.T + 0.0)
            end = end + row.nnz
            yield arrays(end, row)

    shapes = {"camera_shape": [pixels + cells, 1], "projector_shape": [samples, 1]}
    shapes["background_grid"] = [1, 1]
    fill_store(part, parts(), shapes, {}, _CHUNK, QUICK)


@dataclass(frozen=True, eq=False, repr=False)
class ColumnIndex(ShortRepr):
    """The columns of a matrix on disk, of which only the requested ones are read.

    Made by `open`.

    Parameters
    ----------
    matrix, columns : StoredTransport
        The matrix, and the transposed one.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("indexed.zarr", lm.truth("metal").transport())
    >>> lm.index_columns("indexed.zarr")
    >>> lm.ColumnIndex.open("indexed.zarr").matrix.shape
    (4096, 4096)
    """

    matrix: StoredTransport
    columns: StoredTransport
    # Rows of the transposed matrix from some place on, kept because the next stroke is near the
    # last.
    _kept: dict[int, csr_array] = field(default_factory=dict, repr=False)

    @classmethod
    def open(cls, path: str | Path) -> "ColumnIndex":
        """Open the index of a store.

        Raises
        ------
        InputError
            If there is no store, it has no index, or it is damaged.
        """
        matrix = StoredTransport.open(path)
        place = matrix.place / COLUMNS
        if not place.is_dir():
            raise InputError(f"{path}: has no index of its columns", hint="make it: index_columns")
        columns = StoredTransport.open(place, remedy=_REMEDY)
        samples, pixels = matrix.shape
        if columns.shape != (pixels + math.prod(matrix.background_grid), samples):
            raise InputError(f"{place}: is the index of another matrix", hint=_REMEDY)
        return cls(matrix, columns)

    def light(
        self, pixels: NDArray[np.integer], values: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """The light that the camera sees more of when some projector pixels get brighter.

        Parameters
        ----------
        pixels : (n,) int
            Projector pixels, in the order (row, col).
        values : (n,) float
            How much brighter each of them gets; less than 0 for darker.

        Returns
        -------
        camera_shape float32
            T[:, pixels] @ values, background included.

        Raises
        ------
        InputError
            If the projector has no such pixels, or the index is damaged.
        """
        pixels, change = np.asarray(pixels, np.int64), np.asarray(values, np.float64)
        if pixels.ndim != 1 or pixels.shape != change.shape:
            hint = "give one for each"
            raise InputError(f"{change.shape} values for {pixels.shape} pixels", hint=hint)
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < self.matrix.shape[1]):
            what = f"pixels up to {pixels.max()} of a projector of {self.matrix.shape[1]}"
            raise InputError(what, hint="count them from 0, row by row")
        cells, sizes = self._cells
        means = np.bincount(cells[pixels], change / sizes[cells[pixels]], len(sizes))
        count = self.matrix.shape[1]
        places = np.concatenate(
            [tile_places(pixels, self.matrix.projector_shape), count + np.flatnonzero(means)]
        )
        weights = np.concatenate([change, means[means != 0]]).astype(np.float32)
        image = np.zeros(self.matrix.shape[0], np.float32)
        tile = np.searchsorted(self._starts, places, "right") - 1
        for number in np.unique(tile).tolist():
            inside, rows = tile == number, self._tile(number)
            index = places[inside] - self._starts[number]
            image += np.bincount(index, weights[inside], rows.shape[0]).astype(np.float32) @ rows
        return image.reshape(self.matrix.camera_shape)

    def _tile(self, number: int) -> csr_array:
        """The rows of the transposed matrix that are read together."""
        if number not in self._kept:
            start, stop = self._starts[number : number + 2].tolist()
            rows = self.columns.sparse_rows(start, stop)
            if sum(kept.nnz for kept in self._kept.values()) + rows.nnz > _KEPT_ENTRIES:
                self._kept.clear()
            self._kept[number] = rows
        return self._kept[number]

    @cached_property
    def _cells(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The cell that each projector pixel lies in, (N,), and the number of pixels in each."""
        cells = grid_cells(self.matrix.projector_shape, self.matrix.background_grid)
        return cells, np.bincount(cells)

    @cached_property
    def _starts(self) -> NDArray[np.int64]:
        """The places at which tiles, and then cells, begin, and the end of the last one."""
        rows, cols = self.matrix.projector_shape
        corners = (np.arange(0, rows, _TILE)[:, None] * cols + np.arange(0, cols, _TILE)).ravel()
        tiles = tile_places(corners, self.matrix.projector_shape)
        return np.append(tiles, np.arange(rows * cols, self.columns.shape[0] + 1))
