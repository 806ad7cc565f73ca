"""An index of the columns of a store, so that a brush stroke reads no more than its columns.

A store is cut into rows, and a column is spread over all of them. The index keeps the entries a
second time, as the transposed matrix. The columns of 32 x 32 projector pixels stand together.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import STORE
from lightmatrix.files.writing import as_output_error, claimed, final_target, locked
from lightmatrix.files.zarr_arrays import (
    QUICK,
    StoredArray,
    as_damage_error,
    create_array,
    read_attributes,
    write_parts,
)
from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.reprs import short_repr
from lightmatrix.resources.disk import check_disk_space
from lightmatrix.transport.sparse_rows import check_indptr, checked_float32, row_blocks
from lightmatrix.transport.store import StoredTransport, seal, sealed_arrays

# The folder of an index within a store, and that of one that is not whole yet. The next run removes
# what a killed run left there.
COLUMNS, _PART = "columns", ".columns.part"
# Entries that are transposed at once. Each takes 8 bytes, and 8 more while they are joined.
_PASS_ENTRIES = 1 << 26
# Rows and columns of projector pixels whose columns stand together.
_TILE = 32
# Entries of a chunk of the index: few, so that the pixels of a brush read little else.
_CHUNK = 1 << 16
# Bytes of chunks, and of background cells, that an index keeps in memory.
_KEPT_CHUNKS, _KEPT_CELLS = 1 << 27, 1 << 26
_REMEDY = "make it again with index_columns"


def index_columns(
    path: str | Path, *, overwrite: bool = False, progress: Callable[[int, int], None] | None = None
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
    with locked(target := final_target(path)):
        _remove_leftovers(target)
    with claimed(path, STORE, overwrite=True) as target, as_output_error(path):
        if (target / COLUMNS).exists() and not overwrite:
            raise InputError(f"{path}: has an index already", hint="pass overwrite=True")
        background = matrix.arrays["background"].bytes
        check_disk_space(target, 8 * matrix.entries + 8 * matrix.shape[1] + background, path)
        part = target / _PART
        shutil.rmtree(part, ignore_errors=True)
        try:
            _write_index(part, matrix, progress or (lambda done, total: None))
            shutil.rmtree(target / COLUMNS, ignore_errors=True)
            os.rename(part, target / COLUMNS)
        finally:
            shutil.rmtree(part, ignore_errors=True)
        STORE.mark(target)


def _remove_leftovers(target: Path) -> None:
    """Remove what a killed run left, which would otherwise count as somebody else's file."""
    marker = read_attributes(target).get("output")
    listed = marker.get("files") if isinstance(marker, dict) else None
    finished = isinstance(listed, dict) and any(name.startswith(f"{COLUMNS}/") for name in listed)
    with as_output_error(target):
        for name in (_PART, *(() if finished else (COLUMNS,))):
            if (target / name).is_dir() and not (target / name).is_symlink():
                shutil.rmtree(target / name)


def tile_places(pixels: NDArray[np.integer], projector_shape: tuple[int, int]) -> NDArray[np.int64]:
    """Places 0 to N - 1 of projector pixels in the index: by tiles of 32 x 32, row by row.

    The pixels of a brush, which lie beside and below each other, then stand together.
    """
    rows, cols = projector_shape
    row, col = np.divmod(pixels, cols)
    top, left = row - row % _TILE, col - col % _TILE
    height, width = np.minimum(_TILE, rows - top), np.minimum(_TILE, cols - left)
    # Pixels in the rows of tiles above, in the tiles to the left, and before it in its own tile.
    return top * cols + left * height + (row - top) * width + col - left


def _write_index(part: Path, matrix: StoredTransport, progress: Callable[[int, int], None]) -> None:
    """Write the transposed matrix, its rows in the order of `tile_places`, in bounded memory."""
    samples, pixels = matrix.shape
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

    def columns() -> Iterator[dict[str, NDArray[Any]]]:
        counts = sum(np.bincount(block.indices, minlength=pixels)[order] for block in blocks())
        ends = np.concatenate([[0], np.cumsum(counts)])
        for first, last in itertools.pairwise(row_blocks(ends, _PASS_ENTRIES)):
            some = order[first:last]
            rows = hstack([block[:, some].T.tocsr() for block in blocks()], format="csr")
            # The first row's beginning is that of the array as well.
            begin = first + 1 if first else 0
            yield {"indptr": ends[begin : last + 1], "indices": rows.indices, "data": rows.data}

    group = zarr.open_group(part, mode="w", zarr_format=3)
    write_parts(group, columns(), _CHUNK, QUICK)
    # The background has a row for each cell, which is read without the others.
    cells = math.prod(matrix.background_grid)
    chunk = max(1, min(samples, _PASS_ENTRIES // (4 * cells)))
    by_cells = create_array(group, "background", (cells, samples), np.float32, (1, chunk), QUICK)
    for start in range(0, samples, chunk):
        stop = min(start + chunk, samples)
        by_cells[:, start:stop] = matrix.background(start, stop).T
    group.attrs["matrix"] = matrix.digest
    seal(part)


@dataclass(frozen=True, eq=False)
class ColumnIndex:
    """The columns of a matrix on disk, of which only the requested ones are read.

    Made by `open`.

    Parameters
    ----------
    matrix : StoredTransport
    arrays : dict of str to StoredArray
        ``indptr``, ``indices``, ``data`` and ``background``.

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
    # Chunks are kept once they were read, because the next stroke is near the last.
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
        place = matrix.place / COLUMNS
        if not place.is_dir():
            raise InputError(f"{path}: has no index of its columns", hint="make it: index_columns")
        with as_damage_error(place, _REMEDY):
            entries, by_cells = (matrix.entries,), matrix.arrays["background"].shape[::-1]
            ends = (matrix.shape[1] + 1,)
            wanted: dict[str, tuple[int, ...]] = {"background": by_cells, "indptr": ends}
            wanted |= {"indices": entries, "data": entries}
            attributes = read_attributes(place)
            arrays = sealed_arrays(place, wanted, attributes)
            same = all(arrays[name].shape == shape for name, shape in wanted.items())
            if attributes["matrix"] != matrix.digest or not same:
                raise ValueError("it is the index of another matrix")
        index = cls(matrix, arrays)
        # Read now, so that damage of it is reported at once.
        assert len(index._ends) > 0
        return index

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
            # The entries of each pixel in this chunk, counted from the chunk's beginning.
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
        """The numbers of the chunks that hold some columns, after all of them were read."""
        ends, lit = self._ends, places[self._ends[places] < self._ends[places + 1]]
        spans = zip(ends[lit] // _CHUNK, (ends[lit + 1] - 1) // _CHUNK, strict=True)
        wanted = sorted({k for first, last in spans for k in range(first, last + 1)})
        missing = [k for k in wanted if k not in self._kept]
        if 8 * _CHUNK * (len(self._kept) + len(missing)) > _KEPT_CHUNKS:
            self._kept.clear()
            missing = wanted
        # Chunks that follow each other are read together: each reading takes time of its own.
        for run in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
            if len(run):
                self._read(int(run[0]), int(run[-1]) + 1)
        return wanted

    def _read(self, first: int, last: int) -> None:
        span = slice(first * _CHUNK, last * _CHUNK)
        with self._damage():
            rows = self.arrays["indices"].read(span)
            if len(rows) and not (rows.min() >= 0 and rows.max() < self.matrix.shape[0]):
                raise ValueError("a row lies outside the matrix")
            data = checked_float32(self.arrays["data"].read(span), "data")
        for k in range(first, last):
            part = slice((k - first) * _CHUNK, (k - first + 1) * _CHUNK)
            self._kept[k] = rows[part], data[part]

    def _background(self, cell: int) -> NDArray[np.float32]:
        """The values of one cell of the background, one for each camera sample."""
        if cell not in self._kept_cells:
            if 4 * self.matrix.shape[0] * (len(self._kept_cells) + 1) > _KEPT_CELLS:
                self._kept_cells.clear()
            with self._damage():
                values = self.arrays["background"].read(slice(cell, cell + 1))
                self._kept_cells[cell] = checked_float32(values, "background")[0]
        return self._kept_cells[cell]

    def _damage(self) -> AbstractContextManager[None]:
        return as_damage_error(self.matrix.place / COLUMNS, _REMEDY)

    @cached_property
    def _cells(self) -> NDArray[np.int64]:
        """The cell that each projector pixel lies in."""
        return grid_cells(self.matrix.projector_shape, self.matrix.background_grid)

    @cached_property
    def _cell_sizes(self) -> NDArray[np.int64]:
        return np.bincount(self._cells)

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        with self._damage():
            ends = self.arrays["indptr"].read()
            check_indptr(ends, self.matrix.entries)
        return ends.astype(np.int64)
