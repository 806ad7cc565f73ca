"""Walsh-Hadamard patterns, multiplied by a fast transform."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet, check_geometry, seed_sequence
from lightmatrix.ranges import check_seed

HADAMARD_ORDERS = ("natural", "sequency", "random")


@dataclass(frozen=True, eq=False)
class HadamardPatterns(PatternSet):
    """Walsh-Hadamard patterns shifted to 0/1, (H + 1) / 2, applied by a fast transform.

    The transform is two-dimensional on the projector grid enlarged to powers of two (a Kronecker
    product of two one-dimensional ones); pixels outside the projector are left out.

    Parameters
    ----------
    count : int
        At most the number of pixels of the enlarged grid.
    order : {"natural", "sequency", "random"}
        Which patterns come first: Sylvester's order, few sign changes first (vertical plus
        horizontal), or a random choice. The first pattern of the first two is all white.
    permute : bool
        Whether the projector pixels are shuffled, which makes the patterns look random and hence
        incoherent with the blocks and edges of a scene.
    """

    shape: tuple[int, int]
    count: int
    order: str = "natural"
    permute: bool = False
    seed: int = 0

    kind: ClassVar[str] = "hadamard"

    def __post_init__(self) -> None:
        check_geometry(self.shape, self.count)
        check_seed(self.seed)
        if self.order not in HADAMARD_ORDERS:
            hint = f"use one of {', '.join(HADAMARD_ORDERS)}"
            raise InputError(f"an order called {self.order!r}", hint=hint)
        if self.count > self.transform_size:
            raise InputError(
                f"{self.count} Hadamard patterns for a projector of "
                f"{self.shape[0]} x {self.shape[1]}",
                hint=f"there are {self.transform_size}",
            )

    @property
    def grid(self) -> tuple[int, int]:
        """The projector grid enlarged to powers of two."""
        rows, cols = (1 << (size - 1).bit_length() for size in self.shape)
        return rows, cols

    @property
    def transform_size(self) -> int:
        """Length n of the fast transform, a power of two >= N."""
        return self.grid[0] * self.grid[1]

    @cached_property
    def selected(self) -> NDArray[np.int64]:
        """The rows of the Sylvester matrix of order n that are the patterns, (K,) int64."""
        if self.order == "natural":
            return np.arange(self.count, dtype=np.int64)
        if self.order == "sequency":
            # Sign changes along the rows of Sylvester's matrices.
            down, across = (
                np.count_nonzero(np.diff(scipy.linalg.hadamard(size)), axis=1) for size in self.grid
            )
            changes = np.add.outer(down, across)
            return np.argsort(changes.ravel(), kind="stable")[: self.count].astype(np.int64)
        generator = np.random.Generator(np.random.PCG64(self.seed))
        return generator.permutation(self.transform_size)[: self.count].astype(np.int64)

    @cached_property
    def position(self) -> NDArray[np.int64]:
        """The place of each projector pixel in the transform, (N,) int64."""
        rows, cols = self.shape
        place = (np.arange(rows)[:, None] * self.grid[1] + np.arange(cols)[None, :]).ravel()
        if self.permute:
            child = seed_sequence(self.seed, self.shape).spawn(1)[0]
            shuffle = np.random.Generator(np.random.PCG64(child)).permutation(self.transform_size)
            place = shuffle[place]
        return place.astype(np.int64)

    @property
    def transform(self) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
        return self.transform_size, self.selected, self.position

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        x = np.ascontiguousarray(x)
        padded = np.zeros((len(x), self.transform_size), x.dtype)
        padded[:, self.position] = x
        signed = _core.hadamard(padded)[:, self.selected]
        # The patterns are (H + 1) / 2, and the ones give each row's sum.
        return np.asarray((signed + x.sum(axis=1, keepdims=True, dtype=x.dtype)) / 2, x.dtype)

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        e = np.ascontiguousarray(e)
        padded = np.zeros((len(e), self.transform_size), e.dtype)
        padded[:, self.selected] = e
        signed = _core.hadamard(padded)[:, self.position]
        return np.asarray((signed + e.sum(axis=1, keepdims=True, dtype=e.dtype)) / 2, e.dtype)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return self._lit(self.selected, self.position[np.asarray(index, np.int64)])

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        return self._lit(self.selected[start:stop], self.position)

    @staticmethod
    def _lit(row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.float32]:
        # An entry of Sylvester's matrix is -1 to the number of bits that row and column share.
        bits = row[:, None] & col[None, :]
        for shift in (32, 16, 8, 4, 2, 1):
            bits ^= bits >> shift
        return 1 - (bits & 1).astype(np.float32)
