"""`SparseRows`, some rows of a light transport matrix, and checks of matrices that were read.

Compiled routines trust indices, and users trust values. A check raises a ValueError that says what
is wrong; the reader adds the name of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError
from lightmatrix.files.numpy_files import as_float32

# How arrays of diagnostics are named among those of `SparseRows.arrays`.
_DIAGNOSTIC = "diagnostic_"
# Its arrays that have a value for each entry; the others have one for each row.
_OF_ENTRIES = ("data", "indices")


@dataclass(frozen=True, eq=False)
class SparseRows:
    """m rows of a light transport matrix: sparse coefficients, background and diagnostics."""

    # (m, N) in units of camera sample per unit of projector pixel.
    coefficients: csr_array
    # (m, B).
    background: NDArray[Any]
    # Facts about each row, such as its gap, (m,) each.
    diagnostics: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of rows m."""
        return int(self.coefficients.shape[0])

    def rows(self, index: slice | NDArray[np.integer]) -> SparseRows:
        """Some of the rows, in the order of the index."""
        diagnostics = {name: values[index] for name, values in self.diagnostics.items()}
        return SparseRows(csr_array(self.coefficients[index]), self.background[index], diagnostics)

    def replaced(self, places: NDArray[np.int64], new: SparseRows) -> SparseRows:
        """These rows with new ones at some places."""
        order = np.arange(self.count)
        order[places] = self.count + np.arange(new.count)
        return SparseRows.joined([self, new]).rows(order)

    def single(self) -> SparseRows:
        """The same rows in single precision."""
        coefficients = csr_array(self.coefficients, dtype=np.float32)
        return SparseRows(coefficients, self.background.astype(np.float32), self.diagnostics)

    def rounded(self) -> SparseRows:
        """The rows in single precision with 12 significant bits, which take half the disk.

        Entries err by 0.00024 of themselves at most, the background by as much of the row's
        largest: far less than any estimate does.
        """
        rows = self.single()
        bits = rows.coefficients.data.view(np.uint32)
        rows.coefficients.data = ((bits + 0x800) & 0xFFFFF000).view(np.float32)
        largest = np.abs(rows.background).max(axis=1, keepdims=True, initial=0)
        step = np.exp2(np.maximum(np.frexp(largest)[1], -100) - 12).astype(np.float32)
        return replace(rows, background=np.rint(rows.background / step) * step)

    @classmethod
    def joined(cls, parts: Iterable[SparseRows], size: tuple[int, int] | None = None) -> SparseRows:
        """The rows of one or more parts, which have the same diagnostics, below each other.

        With a `size`, the rows and entries that all parts have at most, parts may be made one after
        the other, so that T is not in memory twice. A part with all rows is returned as it is.
        """
        if size is None:
            parts = list(parts)
            size = sum(part.count for part in parts), sum(part.coefficients.nnz for part in parts)
        # The system gives memory when it is written, so a bound may exceed what is needed.
        whole, ends, row, entry = dict[str, NDArray[Any]](), [np.zeros(1, np.int64)], 0, 0
        form: tuple[Any, ...] = ()
        for part in parts:
            if part.count == size[0]:
                return part
            arrays = part.arrays()
            columns = int(arrays.pop("shape")[1])
            ends.append(arrays.pop("indptr")[1:] + np.int64(entry))
            arrays["indices"] = arrays["indices"].astype(_index_type(columns), copy=False)
            own = columns, {name: (each.shape[1:], each.dtype) for name, each in arrays.items()}
            if own != (form := form or own):
                raise ValueError("parts of rows differ in columns, diagnostics or precision")
            for name, array in arrays.items():
                start, most = (entry, size[1]) if name in _OF_ENTRIES else (row, size[0])
                if name not in whole:
                    whole[name] = np.empty((most, *array.shape[1:]), array.dtype)
                whole[name][start : start + len(array)] = array
            row, entry = row + part.count, entry + part.coefficients.nnz
        for name, array in whole.items():
            whole[name] = array[: entry if name in _OF_ENTRIES else row]
        whole["indptr"] = np.concatenate(ends).astype(_index_type(entry, columns))
        named = {n.removeprefix(_DIAGNOSTIC): each for n, each in whole.items() if _DIAGNOSTIC in n}
        matrix = csr_array((whole["data"], whole["indices"], whole["indptr"]), shape=(row, columns))
        return cls(matrix, whole["background"], named)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The rows as named arrays, for `from_arrays`."""
        return {
            "data": self.coefficients.data, "indices": self.coefficients.indices,
            "indptr": self.coefficients.indptr, "shape": np.array(self.coefficients.shape),
            "background": self.background,
            **{_DIAGNOSTIC + name: values for name, values in self.diagnostics.items()},
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rows from the arrays of `arrays()`; an InputError refuses what does not fit together."""
        try:
            count, pixels = (int(size) for size in arrays["shape"])
            parts = arrays["data"], arrays["indices"], arrays["indptr"]
            matrix, background = csr_array(parts, shape=(count, pixels)), arrays["background"]
            matrix.check_format(full_check=True)
            named = [name for name in arrays if name.startswith(_DIAGNOSTIC)]
            diagnostics = {name.removeprefix(_DIAGNOSTIC): arrays[name] for name in named}
            if background.shape[:-1] != (count,):
                raise ValueError(f"a background of shape {background.shape} for {count} rows")
            for name, values in diagnostics.items():
                if values.shape != (count,):
                    raise ValueError(f"a diagnostic {name!r} of shape {values.shape}")
            for part in (matrix.data, background):
                if part.dtype not in (np.float32, np.float64) or not np.isfinite(part).all():
                    raise ValueError("coefficients that are not finite numbers")
        except (KeyError, TypeError, ValueError) as error:
            hint = "the file is damaged: create it again"
            raise InputError(f"arrays that do not hold sparse rows: {error}", hint=hint) from error
        return cls(matrix, background, diagnostics)


def stack_rows(parts: Sequence[csr_array]) -> csr_array:
    """Sparse matrices of equal width, stacked below each other, with 32-bit indices if they fit.

    SciPy may give 64-bit ones, which take half as much memory again, and products longer.
    """
    stacked = csr_array(vstack(parts, format="csr"))
    places, kind = (stacked.indices, stacked.indptr), _index_type(stacked.nnz, *stacked.shape)
    stacked.indices, stacked.indptr = (part.astype(kind, copy=False) for part in places)
    return stacked


def _index_type(*largest: int) -> type[np.signedinteger[Any]]:
    """The type of indices up to some numbers: 32-bit ones if they fit."""
    return np.int32 if max(largest) <= np.iinfo(np.int32).max else np.int64


def footprint_sizes(rows: csr_array) -> NDArray[np.float64]:
    """The effective number of projector pixels in each row, (M,): (sum t)^2 / sum t^2.

    A Gaussian spot of standard deviation s counts about 4 pi s^2; rows without light have 0.
    """
    light = np.asarray(rows.sum(axis=1), np.float64).ravel()
    squares = np.asarray(rows.multiply(rows).sum(axis=1), np.float64).ravel()
    return np.where(squares > 0, light**2 / np.where(squares > 0, squares, 1), 0)


def row_blocks(ends: NDArray[np.integer], most: int) -> NDArray[np.int64]:
    """Rows from 0 to M that cut a CSR matrix (its indptr) into blocks of about `most` entries."""
    parts = max(1, -(-int(ends[-1]) // most))
    inner = np.linspace(0, ends[-1], parts + 1)[1:-1]
    return np.unique([0, *np.searchsorted(ends, inner), len(ends) - 1])


def checked_shape(
    value: Any,
    lengths: Sequence[int],
    name: str,
    pixels: Callable[[tuple[int, ...]], int] = math.prod,
) -> tuple[int, ...]:
    """A stored shape of a permitted length: positive whole numbers, not too many pixels.

    `pixels` counts the pixels that are limited: the product of the sides of an image, the longer
    side of a matrix, whose sides are camera samples and projector pixels.
    """
    # True counts as 1 in an array, but is no number of pixels.
    exact = not isinstance(value, list) or all(type(n) is int for n in value)
    array = np.asarray(value)
    if not exact or array.ndim != 1 or len(array) not in lengths or array.dtype.kind not in "iu":
        raise ValueError(f"{name} is no shape")
    shape = tuple(int(n) for n in array)
    # SciPy's indices count rows and columns in 32 bits.
    if min(shape) < 1 or pixels(shape) >= 1 << 31:
        raise ValueError(f"{name} is {' x '.join(map(str, shape))}")
    return shape


def checked_matrix(
    data: NDArray[Any], indices: NDArray[Any], indptr: NDArray[Any], shape: tuple[int, int]
) -> csr_array:
    """The sparse float32 matrix (M, N) of a CSR matrix's three arrays, checked one by one."""
    rows, cols = shape
    if data.ndim != 1 or indices.shape != data.shape or indptr.shape != (rows + 1,):
        raise ValueError("its arrays do not fit each other")
    if indices.dtype.kind not in "iu" or indptr.dtype.kind not in "iu":
        raise ValueError("its indices are not whole numbers")
    values = checked_float32(data, "data")
    check_indptr(indptr, len(data))
    if len(indices) and not (indices.min() >= 0 and indices.max() < cols):
        raise ValueError(f"an index lies outside the {cols} columns")
    # Stores keep indptr in 64 bits, and SciPy would widen the indices to that.
    if max(len(data), cols) <= np.iinfo(np.int32).max:
        indices, indptr = (part.astype(np.int32, copy=False) for part in (indices, indptr))
    matrix = csr_array((values, indices, indptr), shape=shape)
    matrix.check_format(full_check=True)
    return matrix


def check_indptr(indptr: NDArray[Any], entries: int) -> None:
    """Check that the ends of rows rise from 0 to the number of entries."""
    if indptr.dtype.kind not in "iu":
        raise ValueError("its indices are not whole numbers")
    # Compared, not subtracted: differences of unsigned numbers are never negative.
    if indptr[0] != 0 or indptr[-1] != entries or (indptr[1:] < indptr[:-1]).any():
        raise ValueError("indptr does not rise from 0 to the number of entries")


def checked_float32(values: NDArray[Any], name: str) -> NDArray[np.float32]:
    """Numbers as float32, all of them finite; `name` is what the message calls them."""
    if values.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds {values.dtype} values")
    single = as_float32(values)
    if not np.isfinite(single).all():
        raise ValueError(f"{name} holds values that are not finite")
    return single
