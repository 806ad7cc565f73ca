"""Patterns that light one block of projector pixels at a time, or one pixel."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet, check_geometry
from lightmatrix.ranges import check_sides, real_array


@dataclass(frozen=True, eq=False, repr=False)
class BlockPatterns(PatternSet):
    """One block of projector pixels lit at a time; by default, one pixel: T column by column.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    block : (int, int)
        Rows and columns of a block; blocks at the border may be smaller.
    selected : (K,) int, optional
        Which blocks, in the order (block row, block col); None means all.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.BlockPatterns((4, 4), block=(2, 2)).images()[1]
    array([[0., 0., 1., 1.],
           [0., 0., 1., 1.],
           [0., 0., 0., 0.],
           [0., 0., 0., 0.]], dtype=float32)
    """

    shape: tuple[int, int]
    block: tuple[int, int] = (1, 1)
    selected: NDArray[np.int64] | None = None

    kind: ClassVar[str] = "blocks"

    def __post_init__(self) -> None:
        check_geometry(self.shape, 1)
        check_sides("a block", self.block)
        if self.selected is not None:
            selected = real_array("numbers of blocks", self.selected)
            if selected.ndim != 1 or selected.dtype.kind not in "iu":
                raise InputError("numbers of blocks", hint="give a list of whole numbers")
            object.__setattr__(self, "selected", selected.astype(np.int64))
        check_geometry(self.shape, self.count)
        index = self.index
        total = self.grid[0] * self.grid[1]
        if len(index) and (index.min() < 0 or index.max() >= total):
            raise InputError(f"block {index.max()} of {total}", hint=f"use 0 to {total - 1}")

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.index)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        return -(-self.shape[0] // self.block[0]), -(-self.shape[1] // self.block[1])

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """The block lit by each pattern, (K,) int64."""
        if self.selected is None:
            return np.arange(self.grid[0] * self.grid[1], dtype=np.int64)
        return np.asarray(self.selected, np.int64)

    @cached_property
    def _block_of_pixel(self) -> NDArray[np.int64]:
        row, col = np.divmod(np.arange(self.pixels, dtype=np.int64), self.shape[1])
        return row // self.block[0] * self.grid[1] + col // self.block[1]

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        entries = (np.ones(self.pixels, x.dtype), (self._block_of_pixel, np.arange(self.pixels)))
        sums = csr_array(entries, shape=(self.grid[0] * self.grid[1], self.pixels)) @ x.T
        return np.ascontiguousarray(np.asarray(sums)[self.index].T)

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        per_block = np.zeros((len(e), self.grid[0] * self.grid[1]), e.dtype)
        np.add.at(per_block.T, self.index, e.T)
        return per_block[:, self._block_of_pixel]

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return (self.index[:, None] == self._block_of_pixel[index][None, :]).astype(np.float32)

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        lit = self.index[start:stop, None] == self._block_of_pixel[None, :]
        return lit.astype(np.float32)


def sampled_pixels(shape: tuple[int, int], step: int = 8, offset: int = 4) -> NDArray[np.int64]:
    """Flat indices of the projector pixels (offset + step i, offset + step j); paper's Fig. 6."""
    rows = np.arange(offset, shape[0], step)
    cols = np.arange(offset, shape[1], step)
    return (rows[:, None] * shape[1] + cols[None, :]).ravel().astype(np.int64)
