"""Coarse grids over the projector: means over blocks of pixels, cells of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError

# The longest side of a bin in pixels, more than any camera or projector has.
_LARGEST_BLOCK = 1 << 20


def block_size(block: int | tuple[int, int], what: str) -> tuple[int, int]:
    """Rows and columns of a block of `what` pixels, given as such or as one number for both."""
    rows, cols = (block, block) if isinstance(block, (int, np.integer)) else block
    if not 1 <= min(rows, cols) <= max(rows, cols) <= _LARGEST_BLOCK:
        raise InputError(
            f"the {what} binned by {rows} x {cols} pixels",
            hint=f"use 1 to {_LARGEST_BLOCK}, such as 8",
        )
    return int(rows), int(cols)


def block_mean(images: NDArray[Any], block: tuple[int, int]) -> NDArray[np.float64]:
    """Means over blocks of the last two axes; blocks at the border may be smaller."""
    result: NDArray[np.float64] = np.asarray(images, np.float64)
    for axis, size in ((-2, block[0]), (-1, block[1])):
        starts = np.arange(0, result.shape[axis], size)
        lengths = np.diff(np.append(starts, result.shape[axis]))
        result = np.add.reduceat(result, starts, axis=axis)
        result /= lengths[:, None] if axis == -2 else lengths
    return result


def grid_cells(shape: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.int64]:
    """The cell (row by row) of a coarse grid that each pixel lies in, (N,); none is empty."""
    check_grid(shape, grid)
    row = np.arange(shape[0]) * grid[0] // shape[0]
    col = np.arange(shape[1]) * grid[1] // shape[1]
    return (row[:, None] * grid[1] + col[None, :]).ravel()


def check_grid(shape: tuple[int, int], grid: tuple[int, int]) -> None:
    """Refuse grids with more rows or columns than the projector, or none."""
    if min(grid) < 1 or grid[0] > shape[0] or grid[1] > shape[1]:
        raise InputError(
            f"a grid of {grid[0]} x {grid[1]} cells on a projector of {shape[0]} x {shape[1]}",
            hint="use at least 1 and at most one cell a pixel",
        )
