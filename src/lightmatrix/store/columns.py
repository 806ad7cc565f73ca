"""An index of the columns of a matrix on disk, so that a brush stroke reads no more than its light.

Rows are what a matrix on disk is cut into, and a column is spread over all of them. The index keeps
the entries a second time, column by column.
"""

from __future__ import annotations

import itertools
import os
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import zarr
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import (
    GrowingArray,
    StoredArray,
    damage_explained,
    read_attributes,
)
from lightmatrix.outputs.kinds import STORE
from lightmatrix.outputs.locks import check_unlocked
from lightmatrix.outputs.room import check_disk
from lightmatrix.outputs.targets import explained, final_target
from lightmatrix.outputs.writing import claimed
from lightmatrix.store.checked import check_indptr, finite
from lightmatrix.store.lazy import StoredTransport

COLUMNS = "columns"
# Where it is written before it is whole; a run that was killed leaves it, and the next sweeps it.
_PART = ".columns.part"
_ARRAYS = {"indptr": np.int64, "rows": np.int32, "data": np.float32}
# Entries that are turned over together, 12 bytes each and as much again while they are sorted.
_PASS_ENTRIES = 1 << 26
# Of a chunk, small enough that the pixels of a brush read little besides.
_CHUNK = 1 << 16
_AGAIN = "make it again with index_columns"


def index_columns(path: str | Path, *, overwrite: bool = False) -> None:
    """Add an index of its columns to a matrix on disk.

    It takes as much space again, and a gigabyte and a half of memory at most.

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
        check_disk(target, 8 * matrix.entries + 8 * matrix.shape[1], path)
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


def _write(part: Path, matrix: StoredTransport) -> None:
    pixels = matrix.shape[1]
    counts = np.zeros(pixels, np.int64)
    for _, block in matrix.blocks():
        counts += np.bincount(block.coefficients.indices, minlength=pixels)
    ends = np.concatenate([[0], np.cumsum(counts)])
    group = zarr.open_group(part, mode="w", zarr_format=3)
    arrays = {name: GrowingArray(group, name, dtype, _CHUNK) for name, dtype in _ARRAYS.items()}
    arrays["indptr"].add(ends)
    passes = max(1, -(-int(ends[-1]) // _PASS_ENTRIES))
    inner = np.linspace(0, ends[-1], passes + 1)[1:-1]
    cuts = np.unique([0, *np.searchsorted(ends, inner), pixels])
    for first, last in itertools.pairwise(cuts):
        columns, rows, data = [], [], []
        for start, block in matrix.blocks():
            found = block.coefficients.tocoo()
            inside = (found.col >= first) & (found.col < last)
            columns.append(found.col[inside].astype(np.int32))
            rows.append((start + found.row[inside]).astype(np.int32))
            data.append(found.data[inside])
        order = np.argsort(np.concatenate(columns), kind="stable")
        arrays["rows"].add(np.concatenate(rows)[order])
        arrays["data"].add(np.concatenate(data)[order])
    for array in arrays.values():
        array.close()


@dataclass(frozen=True, eq=False)
class ColumnIndex:
    """The columns of a matrix on disk, of which as many are read as are asked for.

    Made by `open`.

    Parameters
    ----------
    matrix : StoredTransport
    arrays : dict of str to StoredArray
        ``indptr``, ``rows`` and ``data``.

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
            arrays = {name: StoredArray.open(place / name) for name in _ARRAYS}
            wanted = (matrix.entries,)
            if arrays["rows"].shape != wanted or arrays["data"].shape != wanted:
                raise ValueError("it is the index of another matrix")
            if arrays["indptr"].shape != (matrix.shape[1] + 1,):
                raise ValueError("it is the index of another projector")
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
        order = np.argsort(pixels, kind="stable")
        pixels, change = pixels[order], change[order]
        image = np.zeros(self.matrix.shape[0])
        # Pixels beside each other lie beside each other.
        for run in np.split(np.arange(len(pixels)), np.flatnonzero(np.diff(pixels) > 1) + 1):
            if len(run):
                self._add(image, pixels[run], change[run])
        shown = csr_array(
            (change, (pixels, np.zeros_like(pixels))), shape=(self.matrix.shape[1], 1)
        )
        means = (self.matrix.pooling @ shown).toarray()[:, 0]
        if means.any():
            image += self._background @ means
        return image.astype(np.float32).reshape(self.matrix.camera_shape)

    def _add(
        self, image: NDArray[np.float64], pixels: NDArray[np.integer], change: NDArray[np.float64]
    ) -> None:
        ends = self._ends
        span = slice(int(ends[pixels[0]]), int(ends[pixels[-1] + 1]))
        with damage_explained(self.matrix.stored.place / COLUMNS, _AGAIN):
            rows = self.arrays["rows"].read(span)
            if len(rows) and not (rows.min() >= 0 and rows.max() < len(image)):
                raise ValueError("a row lies outside the matrix")
            data = finite(self.arrays["data"].read(span), "data")
        bright = np.bincount(pixels - pixels[0], change, pixels[-1] - pixels[0] + 1)
        lengths = np.diff(ends[pixels[0] : pixels[-1] + 2])
        np.add.at(image, rows, data * np.repeat(bright, lengths))

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        with damage_explained(self.matrix.stored.place / COLUMNS, _AGAIN):
            ends = self.arrays["indptr"].read()
            check_indptr(ends, self.matrix.entries)
        return ends.astype(np.int64)

    @cached_property
    def _background(self) -> NDArray[np.float32]:
        with damage_explained(self.matrix.stored.place, _AGAIN):
            return finite(self.matrix.stored.arrays["background"].read(), "background")
