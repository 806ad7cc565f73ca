"""Checks of matrices that were read: compiled routines trust indices, and users trust values.

Each check raises a ValueError that says what is wrong; the reader adds the name of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.files.numpy_files import as_float32

# SciPy's indices count rows and columns in 32 bits.
_MOST_PIXELS = 1 << 31


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
    if min(shape) < 1 or pixels(shape) >= _MOST_PIXELS:
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


def checked_diagnostics(
    diagnostics: Mapping[str, NDArray[Any]], rows: int
) -> dict[str, NDArray[Any]]:
    """Stored diagnostics: one number a row, which may be NaN, as gaps are."""
    for name, values in diagnostics.items():
        if values.shape != (rows,) or values.dtype.kind not in "bfiu":
            raise ValueError(f"the diagnostic {name[:40]!r} is not one number a row")
    return dict(diagnostics)
