"""An index of the columns of a matrix on disk, so that a brush stroke reads no more than its light.

Rows are what a matrix on disk is cut into, and a column is spread over all of them. The index keeps
the entries a second time, column by column, the columns of a tile of the projector together, and
the background cell by cell.
"""

from __future__ import annotations

import itertools
import os
import shutil
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import (
    CHUNK,
    QUICK,
    GrowingArray,
    StoredArray,
    create_array,
    damage_explained,
    read_attributes,
)
from lightmatrix.outputs.kinds import STORE
from lightmatrix.outputs.locks import check_unlocked
from lightmatrix.outputs.targets import explained, final_target
from lightmatrix.outputs.writing import claimed
from lightmatrix.patterns.grids import grid_cells
from lightmatrix.reprs import short_repr
from lightmatrix.resources.disk import check_disk
from lightmatrix.store.checked import check_indptr, finite
from lightmatrix.store.lazy import StoredTransport
from lightmatrix.transport.sparse_rows import row_blocks

COLUMNS = "columns"
# Where it is written before it is whole; a run that was killed leaves it, and the next sweeps it.
_PART = ".columns.part"
_ENTRIES = {"indptr": np.int64, "rows": np.int32, "data": np.float32}
# Entries that are turned over together, 12 bytes each and as much again while they are sorted.
_PASS_ENTRIES = 1 << 26
# Values of the background that are turned over together.
_PASS_VALUES = 1 << 24
# Projector pixels of a tile, down and across.
_TILE = 32
# Of a chunk, small enough that the pixels of a brush read little besides.
_CHUNK = 1 << 16
# Chunks that are kept, of 512 KiB each.
_MOST_KEPT = 256
# Bytes of the background's cells that are kept, 4 for each camera sample.
_CELL_BYTES = 1 << 26
_AGAIN = "make it again with index_columns"


def index_columns(path: str | Path, *, overwrite: bool = False) -> None:
    """Add an index of its columns to a matrix on disk.

    It takes about as much space again, and a gigabyte and a half of memory at most.

    Parameters
    ----------
    path : str or Path
        A .zarr folder from `estimate` or `save`.
    overwrite : bool
        Whether an index that it has already is made again.

    Raises
    ------
    InputError
        If there is no matrix, it is damaged, or has an index already.
    OutputError
        If it is being written, was changed by others, the disk has not enough room, or fails.

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
    _sweep(final_target(path))
    with claimed(path, STORE, overwrite=True) as target, explained(path):
        if (target / COLUMNS).exists() and not overwrite:
            raise InputError(f"{path}: has an index already", hint="pass overwrite=True")
        background = matrix.stored.arrays["background"].bytes
        check_disk(target, 8 * matrix.entries + 8 * matrix.shape[1] + background, path)
        part = target / _PART
        shutil.rmtree(part, ignore_errors=True)
        try:
            _write(part, matrix)
            shutil.rmtree(target / COLUMNS, ignore_errors=True)
            os.rename(part, target / COLUMNS)
        finally:
            shutil.rmtree(part, ignore_errors=True)
        STORE.mark(target)


def _sweep(target: Path) -> None:
    """Remove what a killed run left, which would otherwise be in the way as others' files are."""
    check_unlocked(target)
    marker = read_attributes(target).get("output")
    listed = marker.get("files") if isinstance(marker, dict) else None
    finished = isinstance(listed, dict) and any(name.startswith(f"{COLUMNS}/") for name in listed)
    with explained(target):
        for name in (_PART, *(() if finished else (COLUMNS,))):
            if (target / name).is_dir() and not (target / name).is_symlink():
                shutil.rmtree(target / name)


def tile_places(pixels: NDArray[np.integer], projector_shape: tuple[int, int]) -> NDArray[np.int64]:
    """Where projector pixels stand in the index: tile by tile of 32 x 32, row by row in each.

    So that the pixels of a brush, which lie beside and below each other, stand together.

    Parameters
    ----------
    pixels : (n,) int
        In the order (row, col).
    projector_shape : (rows, cols)

    Returns
    -------
    (n,) int64
        Places from 0 to N - 1, another for every pixel.
    """
    rows, cols = projector_shape
    row, col = np.divmod(pixels, cols)
    top, left = row - row % _TILE, col - col % _TILE
    height, width = np.minimum(_TILE, rows - top), np.minimum(_TILE, cols - left)
    # Rows of tiles above, tiles to the left, and within the tile as much again.
    return top * cols + left * height + (row - top) * width + col - left


def _write(part: Path, matrix: StoredTransport) -> None:
    pixels = matrix.shape[1]
    places = tile_places(np.arange(pixels), matrix.projector_shape)
    counts = np.zeros(pixels, np.int64)
    for _, block in matrix.blocks():
        counts += np.bincount(places[block.coefficients.indices], minlength=pixels)
    ends = np.concatenate([[0], np.cumsum(counts)])
    group = zarr.open_group(part, mode="w", zarr_format=3)
    arrays = {
        name: GrowingArray(group, name, dtype, _CHUNK, QUICK) for name, dtype in _ENTRIES.items()
    }
    arrays["indptr"].add(ends)
    for first, last in itertools.pairwise(row_blocks(ends, _PASS_ENTRIES)):
        columns, rows, data = [], [], []
        for start, block in matrix.blocks():
            found = block.coefficients.tocoo()
            column = places[found.col]
            inside = (column >= first) & (column < last)
            columns.append(column[inside].astype(np.int32))
            rows.append((start + found.row[inside]).astype(np.int32))
            data.append(found.data[inside])
        order = np.argsort(np.concatenate(columns), kind="stable")
        arrays["rows"].add(np.concatenate(rows)[order])
        arrays["data"].add(np.concatenate(data)[order])
    for array in arrays.values():
        array.close()
    _write_background(group, matrix)


def _write_background(group: zarr.Group, matrix: StoredTransport) -> None:
    """The background with a row for each cell, which is read without the others."""
    samples, cells = matrix.stored.arrays["background"].shape
    chunk = max(1, min(samples, CHUNK, _PASS_VALUES // cells))
    turned = create_array(group, "background", (cells, samples), np.float32, (1, chunk), QUICK)
    for start in range(0, samples, chunk):
        stop = min(start + chunk, samples)
        turned[:, start:stop] = matrix.background(start, stop).T


@dataclass(frozen=True, eq=False)
class ColumnIndex:
    """The columns of a matrix on disk, of which as many are read as are asked for.

    Made by `open`.

    Parameters
    ----------
    matrix : StoredTransport
    arrays : dict of str to StoredArray
        ``indptr``, ``rows``, ``data`` and ``background``.

    Examples
    --------
    See `index_columns`.

    >>> import lightmatrix as lm
    >>> lm.ColumnIndex.open("gone.zarr")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    lightmatrix.errors.InputError: gone.zarr: no such file
    """

    matrix: StoredTransport
    arrays: dict[str, StoredArray]
    # Chunks that were read, since the next stroke is near the last.
    _kept: dict[int, tuple[NDArray[Any], NDArray[Any]]] = field(default_factory=dict, repr=False)
    _kept_cells: dict[int, NDArray[np.float32]] = field(default_factory=dict, repr=False)

    __repr__ = short_repr

    @classmethod
    def open(cls, path: str | Path) -> ColumnIndex:
        """Open the index of a store.

        Raises
        ------
        InputError
            If there is no store, it has no index, or it is damaged.
        """
        matrix = StoredTransport.open(path)
        place = matrix.stored.place / COLUMNS
        if not place.is_dir():
            raise InputError(f"{path}: has no index of its columns", hint="make it: index_columns")
        with damage_explained(place, _AGAIN):
            entries, pixels = (matrix.entries,), (matrix.shape[1] + 1,)
            turned = matrix.stored.arrays["background"].shape[::-1]
            wanted = {"indptr": pixels, "rows": entries, "data": entries, "background": turned}
            arrays = {name: StoredArray.open(place / name) for name in wanted}
            if any(arrays[name].shape != shape for name, shape in wanted.items()):
                raise ValueError("it is the index of another matrix")
        found = cls(matrix, arrays)
        assert len(found._ends) > 0
        return found

    def light(
        self, pixels: NDArray[np.integer], values: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """What the camera sees more of when some projector pixels get brighter.

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
            On pixels that the projector has not, or damage.
        """
        pixels, change = np.asarray(pixels, np.int64), np.asarray(values, np.float64)
        if pixels.ndim != 1 or pixels.shape != change.shape:
            raise InputError(
                f"{change.shape} values for {pixels.shape} pixels", hint="give one for each"
            )
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < self.matrix.shape[1]):
            raise InputError(
                f"pixels up to {pixels.max()} of a projector of {self.matrix.shape[1]}",
                hint="count them from 0, row by row",
            )
        ends, places = self._ends, tile_places(pixels, self.matrix.projector_shape)
        image = np.zeros(self.matrix.shape[0], np.float32)
        for k in self._chunks(places):
            rows, data = self._kept[k]
            # Of each pixel, its entries in this chunk, counted from the chunk's beginning.
            low = np.clip(ends[places] - k * _CHUNK, 0, len(rows))
            lengths = np.clip(ends[places + 1] - k * _CHUNK, 0, len(rows)) - low
            inside = np.flatnonzero(lengths)
            lengths, low = lengths[inside], low[inside]
            first = np.repeat(low - np.cumsum(lengths) + lengths, lengths)
            entries = first + np.arange(len(first))
            light = data[entries] * np.repeat(change[inside], lengths)
            np.add.at(image, rows[entries], light.astype(np.float32))
        cells = self._cells[pixels]
        means = np.bincount(cells, change / self._cell_sizes[cells])
        for cell in np.flatnonzero(means).tolist():
            image += np.float32(means[cell]) * self._background(cell)
        return image.reshape(self.matrix.camera_shape)

    def _chunks(self, places: NDArray[np.int64]) -> list[int]:
        """Which chunks hold entries of columns at some places, all of them read and kept."""
        ends, some = self._ends, places[self._ends[places] < self._ends[places + 1]]
        spans = zip(ends[some] // _CHUNK, (ends[some + 1] - 1) // _CHUNK, strict=True)
        wanted = sorted({k for first, last in spans for k in range(first, last + 1)})
        missing = [k for k in wanted if k not in self._kept]
        if len(self._kept) + len(missing) > _MOST_KEPT:
            self._kept.clear()
            missing = wanted
        # Chunks that follow each other are read at one go, which is what takes time.
        for run in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
            if len(run):
                self._read(int(run[0]), int(run[-1]) + 1)
        return wanted

    def _read(self, first: int, last: int) -> None:
        span = slice(first * _CHUNK, last * _CHUNK)
        with damage_explained(self.matrix.stored.place / COLUMNS, _AGAIN):
            rows = self.arrays["rows"].read(span)
            if len(rows) and not (rows.min() >= 0 and rows.max() < self.matrix.shape[0]):
                raise ValueError("a row lies outside the matrix")
            data = finite(self.arrays["data"].read(span), "data")
        for k in range(first, last):
            part = slice((k - first) * _CHUNK, (k - first + 1) * _CHUNK)
            self._kept[k] = rows[part], data[part]

    def _background(self, cell: int) -> NDArray[np.float32]:
        """What every camera sample sees of one cell of the background, read and kept."""
        if cell not in self._kept_cells:
            room = _CELL_BYTES // (4 * self.matrix.shape[0])
            if len(self._kept_cells) >= max(1, room):
                # The one that was read first.
                del self._kept_cells[next(iter(self._kept_cells))]
            with damage_explained(self.matrix.stored.place / COLUMNS, _AGAIN):
                found = self.arrays["background"].read(slice(cell, cell + 1))
                self._kept_cells[cell] = finite(found, "background")[0]
        return self._kept_cells[cell]

    @cached_property
    def _cells(self) -> NDArray[np.int64]:
        """The cell that each projector pixel lies in."""
        return grid_cells(self.matrix.projector_shape, self.matrix.background_grid)

    @cached_property
    def _cell_sizes(self) -> NDArray[np.int64]:
        return np.bincount(self._cells)

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        with damage_explained(self.matrix.stored.place / COLUMNS, _AGAIN):
            ends = self.arrays["indptr"].read()
            check_indptr(ends, self.matrix.entries)
        return ends.astype(np.int64)
