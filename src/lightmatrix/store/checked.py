"""What is read of a matrix is checked whole: compiled routines trust indices, and so do users."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.files.npy import as_float32

# Rows and columns are counted in 32 bits by SciPy's indices.
_MOST_PIXELS = 1 << 31


def shape_of(value: Any, lengths: Sequence[int], name: str) -> tuple[int, ...]:
    """A shape as it was stored: positive whole numbers, and not absurdly many pixels.

    Parameters
    ----------
    value : list or array of int
        What was read.
    lengths : sequence of int
        How many numbers it may have.
    name : str
        For the message.

    Raises
    ------
    ValueError
        If it is no such shape.
    """
    array = np.asarray(value)
    if array.ndim != 1 or len(array) not in lengths or array.dtype.kind not in "iu":
        raise ValueError(f"{name} is no shape")
    shape = tuple(int(n) for n in array)
    if min(shape) < 1 or math.prod(shape) >= _MOST_PIXELS:
        raise ValueError(f"{name} is {' x '.join(map(str, shape))}")
    return shape


def checked_matrix(
    data: NDArray[Any], indices: NDArray[Any], indptr: NDArray[Any], shape: tuple[int, int]
) -> csr_array:
    """The sparse matrix of three arrays, after each of them was looked through.

    Parameters
    ----------
    data : (nnz,) float
        Finite, also as float32.
    indices : (nnz,) int
        Columns in [0, N).
    indptr : (M + 1,) int
        Rising from 0 to nnz.
    shape : (M, N)

    Returns
    -------
    (M, N) csr_array float32

    Raises
    ------
    ValueError
        If they are not all that.
    """
    rows, cols = shape
    if data.ndim != 1 or indices.shape != data.shape or indptr.shape != (rows + 1,):
        raise ValueError("its arrays do not fit each other")
    if indices.dtype.kind not in "iu" or indptr.dtype.kind not in "iu":
        raise ValueError("its indices are not whole numbers")
    values = finite(data, "data")
    check_indptr(indptr, len(data))
    if len(indices) and not (indices.min() >= 0 and indices.max() < cols):
        raise ValueError(f"an index lies outside the {cols} columns")
    # SciPy makes both kinds of indices as wide as the wider one, which stores keep in 64 bits.
    if max(len(data), cols) <= np.iinfo(np.int32).max:
        indices, indptr = (part.astype(np.int32, copy=False) for part in (indices, indptr))
    matrix = csr_array((values, indices, indptr), shape=shape)
    matrix.check_format(full_check=True)
    return matrix


def check_indptr(indptr: NDArray[Any], entries: int) -> None:
    """Whether ends of rows can be those of so many entries.

    Raises
    ------
    ValueError
        If they do not rise from 0 to the number of entries.
    """
    if indptr.dtype.kind not in "iu":
        raise ValueError("its indices are not whole numbers")
    # Compared as they are: differences of unsigned numbers are never negative.
    if indptr[0] != 0 or indptr[-1] != entries or (indptr[1:] < indptr[:-1]).any():
        raise ValueError("indptr does not rise from 0 to the number of entries")


def finite(values: NDArray[Any], name: str) -> NDArray[np.float32]:
    """Float values as float32.

    Raises
    ------
    ValueError
        If they are no numbers, or one is not finite in float32.
    """
    if values.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds {values.dtype} values")
    single = as_float32(values)
    if not np.isfinite(single).all():
        raise ValueError(f"{name} holds values that are not finite")
    return single


def checked_diagnostics(found: Mapping[str, NDArray[Any]], rows: int) -> dict[str, NDArray[Any]]:
    """Diagnostics as they were stored: one number a row. They may be NaN, as gaps are.

    Raises
    ------
    ValueError
        On another shape, or what are no numbers.
    """
    for name, values in found.items():
        if values.shape != (rows,) or values.dtype.kind not in "bfiu":
            raise ValueError(f"the diagnostic {name[:40]!r} is not one number a row")
    return dict(found)
