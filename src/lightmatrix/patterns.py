"""Pattern sets as linear operators: what the projector shows, never a dense matrix if avoidable.

A set of K patterns over N projector pixels is the matrix P (K, N) with entries in [0, 1]. Rows of
the light transport matrix are estimated in batches, so the operators act on rows:

    forward:  (M, N) -> (M, K)   samples = X P'
    adjoint:  (M, K) -> (M, N)   correlations = E P

Every set knows how it was made (`description`, which `pattern_kinds` reads back) and a digest
of its content, which ties a capture and an estimate to the patterns they belong to.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.errors import InputError

# Patterns are unpacked in groups of this many bytes, so that memory stays bounded.
_BLOCK_BYTES = 64 << 20

# Bernoulli patterns up to this size are also kept as floats once many rows are multiplied.
_DENSE_BYTES = 128 << 20
_DENSE_ROWS = 8


class PatternSet(ABC):
    """K patterns over a projector of (rows, cols) pixels.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns; N = rows * cols.
    count : int
        Number of patterns K.
    """

    shape: tuple[int, int]
    count: int

    @property
    def pixels(self) -> int:
        """Number of projector pixels N."""
        return self.shape[0] * self.shape[1]

    @abstractmethod
    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        """Samples of rows: x (M, N) -> x P' (M, K), in the dtype of x."""

    @abstractmethod
    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        """Correlations with every projector pixel: e (M, K) -> e P (M, N), in the dtype of e."""

    @abstractmethod
    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        """Chosen columns of P: (K, len(index)) float32."""

    @abstractmethod
    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        """Patterns start..stop of P as float32 (stop - start, N)."""

    @property
    @abstractmethod
    def description(self) -> dict[str, Any]:
        """What remakes the set: a JSON-ready dictionary with the key ``kind``."""

    @cached_property
    def means(self) -> NDArray[np.float64]:
        """Mean of each pattern, (K,) float64."""
        return np.concatenate([block.mean(axis=1, dtype=np.float64) for _, block in self.blocks()])

    @property
    def sums(self) -> NDArray[np.float64]:
        """Sum of each pattern over its pixels, (K,) float64."""
        return self.pixels * self.means

    @cached_property
    def digest(self) -> str:
        """Hash of the patterns' content (8-bit grey, as projected) and shape, 16 hex digits."""
        hasher = hashlib.sha256(repr((self.shape, self.count)).encode())
        for _, block in self.blocks():
            hasher.update(to_grey(block).tobytes())
        return hasher.hexdigest()[:16]

    def blocks(self, size: int | None = None) -> Any:
        """Iterate over (start, rows of P) in blocks of bounded memory."""
        size = size or max(1, _BLOCK_BYTES // (4 * self.pixels))
        for start in range(0, self.count, size):
            yield start, self.rows(start, min(start + size, self.count))

    def images(self, start: int = 0, stop: int | None = None) -> NDArray[np.float32]:
        """Patterns as images: (stop - start, rows, cols) float32 in [0, 1]."""
        block = self.rows(start, self.count if stop is None else stop)
        return block.reshape(-1, *self.shape)

    def dense(self) -> NDArray[np.float32]:
        """The whole of P, (K, N) float32; for small sets and tests."""
        return self.rows(0, self.count)

    @cached_property
    def gram(self) -> NDArray[np.float64]:
        """P P', (K, K) float64."""
        dense = np.empty((self.count, self.count))
        for start, block in self.blocks():
            stop = start + len(block)
            dense[start:stop] = self.forward(block.astype(np.float64))
        return dense

    def coarse(self, block: tuple[int, int]) -> ImagePatterns:
        """The patterns averaged over blocks of projector pixels.

        Parameters
        ----------
        block : (int, int)
            Rows and columns of a block; blocks at the border may be smaller.

        Returns
        -------
        ImagePatterns
            Patterns of ceil(rows / block rows) x ceil(cols / block cols) pixels.
        """
        if min(block) < 1:
            raise InputError(
                f"a block of {block[0]} x {block[1]} pixels", hint="use at least 1 x 1"
            )
        parts = [
            block_mean(part.reshape(-1, *self.shape), block).astype(np.float32)
            for _, part in self.blocks()
        ]
        return ImagePatterns(np.concatenate(parts))

    def subset(self, index: NDArray[np.integer]) -> PatternSet:
        """The patterns of the given indices, as a set of their own."""
        index = np.asarray(index)
        return ImagePatterns(np.stack([self.images(int(k), int(k) + 1)[0] for k in index]))


def to_grey(patterns: NDArray[Any]) -> NDArray[np.uint8]:
    """Patterns in [0, 1] as the 8-bit grey values that are projected."""
    return np.rint(np.asarray(patterns, np.float32) * 255).astype(np.uint8)


def block_mean(images: NDArray[Any], block: tuple[int, int]) -> NDArray[np.float64]:
    """Means over blocks of the last two axes; blocks at the border may be smaller.

    Parameters
    ----------
    images : (..., rows, cols)
        Any real dtype.
    block : (int, int)
        Rows and columns of a block.

    Returns
    -------
    (..., ceil(rows / block rows), ceil(cols / block cols)) float64
    """
    result: NDArray[np.float64] = np.asarray(images, np.float64)
    for axis, size in ((-2, block[0]), (-1, block[1])):
        starts = np.arange(0, result.shape[axis], size)
        lengths = np.diff(np.append(starts, result.shape[axis]))
        result = np.add.reduceat(result, starts, axis=axis)
        result /= lengths[:, None] if axis == -2 else lengths
    return result


def grid_cells(shape: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.int64]:
    """The cell of a coarse grid over the projector that each pixel lies in.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    grid : (int, int)
        Rows and columns of cells; cells are as equal as whole pixels allow, and none is empty.

    Returns
    -------
    (N,) int64
        Cells in the order (row, col).

    Raises
    ------
    InputError
        If the grid has more rows or columns than the projector, or none.
    """
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


def check_geometry(shape: tuple[int, int], count: int) -> None:
    """Refuse projectors without pixels and sets without patterns."""
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(f"a projector of shape {shape}", hint="give (rows, cols), both at least 1")
    if count < 1:
        raise InputError(f"{count} patterns", hint="ask for at least 1")


class PackedPatterns(PatternSet):
    """Patterns of zeros and ones, kept as bits: what the compiled core multiplies fastest.

    Parameters
    ----------
    bits : (K, ceil(N / 8)) uint8
        Lit pixels, least significant bit first.
    """

    bits: NDArray[np.uint8]

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        if self._multiply_dense(x):
            return np.asarray(x @ self._dense.T)
        return _core.bits_forward(self.bits, self.pixels, np.ascontiguousarray(x))

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        if self._multiply_dense(e):
            return np.asarray(e @ self._dense)
        return _core.bits_adjoint(self.bits, self.pixels, np.ascontiguousarray(e))

    def _multiply_dense(self, rows: NDArray[Any]) -> bool:
        # A matrix product of floats outruns sums of bits where its matrix fits, for many rows.
        small = 4 * self.count * self.pixels <= _DENSE_BYTES
        return small and rows.dtype == np.float32 and len(rows) >= _DENSE_ROWS

    @cached_property
    def _dense(self) -> NDArray[np.float32]:
        return self.dense()

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return _core.bits_columns(self.bits, self.pixels, np.asarray(index, np.int64))

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        lit = np.unpackbits(self.bits[start:stop], axis=1, count=self.pixels, bitorder="little")
        return lit.astype(np.float32)

    def subset(self, index: NDArray[np.integer]) -> PatternSet:
        return BitPatterns(self.shape, self.bits[np.asarray(index)])


@dataclass(frozen=True, eq=False)
class BitPatterns(PackedPatterns):
    """Patterns of zeros and ones given as bits, such as some of the patterns of another set.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    bits : (K, ceil(N / 8)) uint8
        Lit pixels, least significant bit first.
    """

    shape: tuple[int, int]
    bits: NDArray[np.uint8]

    def __post_init__(self) -> None:
        check_geometry(self.shape, self.count)
        if self.bits.ndim != 2 or self.bits.shape[1] != (self.pixels + 7) // 8:
            raise InputError(
                f"bits of shape {self.bits.shape} for a projector of shape {self.shape}",
                hint=f"give (K, {(self.pixels + 7) // 8}) bytes",
            )

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.bits)

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "images", "shape": list(self.shape), "count": self.count}


@dataclass(frozen=True, eq=False)
class BernoulliPatterns(PackedPatterns):
    """Random on/off patterns: each projector pixel is lit with probability `density`.

    The patterns of the paper's experiments (after Sen & Darabi 2009), kept as bits.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    count : int
        Number of patterns K.
    density : float
        Probability that a pixel is lit, in (0, 1).
    seed : int
        Seed of the draw; the same seed gives the same patterns on every machine.
    """

    shape: tuple[int, int]
    count: int
    density: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_geometry(self.shape, self.count)
        if not 0 < self.density < 1:
            raise InputError(
                f"a density of {self.density}", hint="use a share between 0 and 1, such as 0.5"
            )

    @cached_property
    def bits(self) -> NDArray[np.uint8]:  # type: ignore[override]
        """Lit pixels, (K, ceil(N / 8)) uint8, least significant bit first."""
        bits = np.empty((self.count, (self.pixels + 7) // 8), np.uint8)
        # One generator a pattern: the first k patterns do not depend on how many follow.
        for k, child in enumerate(np.random.SeedSequence(self.seed).spawn(self.count)):
            lit = np.random.Generator(np.random.PCG64(child)).random(self.pixels) < self.density
            bits[k] = np.packbits(lit, bitorder="little")
        return bits

    @property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "bernoulli",
            "shape": list(self.shape),
            "count": self.count,
            "density": self.density,
            "seed": self.seed,
        }


HADAMARD_ORDERS = ("natural", "sequency", "random")


@dataclass(frozen=True, eq=False)
class HadamardPatterns(PatternSet):
    """Walsh-Hadamard patterns shifted to 0/1, (H + 1) / 2, applied by a fast transform.

    The transform is two-dimensional on the projector grid enlarged to powers of two (a Kronecker
    product of two one-dimensional ones); pixels outside the projector are left out.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    count : int
        Number of patterns K, at most the number of pixels of the enlarged grid.
    order : {"natural", "sequency", "random"}
        Which patterns come first: Sylvester's order, few sign changes first (vertical plus
        horizontal), or a random choice. The first pattern of the first two is all white.
    permute : bool
        Whether the projector pixels are shuffled, which makes the patterns look random and hence
        incoherent with the blocks and edges of a scene.
    seed : int
        Seed of the random choice and of the shuffle.
    """

    shape: tuple[int, int]
    count: int
    order: str = "natural"
    permute: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        check_geometry(self.shape, self.count)
        if self.order not in HADAMARD_ORDERS:
            raise InputError(
                f"an order called {self.order!r}", hint=f"use one of {', '.join(HADAMARD_ORDERS)}"
            )
        if self.count > self.transform_size:
            raise InputError(
                f"{self.count} Hadamard patterns for a projector of "
                f"{self.shape[0]} x {self.shape[1]}",
                hint=f"there are {self.transform_size}",
            )

    @property
    def grid(self) -> tuple[int, int]:
        """The projector grid enlarged to powers of two."""
        return _power_of_two(self.shape[0]), _power_of_two(self.shape[1])

    @property
    def transform_size(self) -> int:
        """Length n of the fast transform, a power of two >= N."""
        return self.grid[0] * self.grid[1]

    @cached_property
    def selected(self) -> NDArray[np.int64]:
        """Which rows of the Sylvester matrix of order n the patterns are, (K,) int64."""
        rows, cols = self.grid
        if self.order == "natural":
            return np.arange(self.count, dtype=np.int64)
        if self.order == "sequency":
            changes = _sequency(rows)[:, None] + _sequency(cols)[None, :]
            return np.argsort(changes.ravel(), kind="stable")[: self.count].astype(np.int64)
        generator = np.random.Generator(np.random.PCG64(self.seed))
        return generator.permutation(self.transform_size)[: self.count].astype(np.int64)

    @cached_property
    def position(self) -> NDArray[np.int64]:
        """Where in the transform each projector pixel sits, (N,) int64."""
        rows, cols = self.shape
        place = (np.arange(rows)[:, None] * self.grid[1] + np.arange(cols)[None, :]).ravel()
        if self.permute:
            child = np.random.SeedSequence(self.seed).spawn(1)[0]
            shuffle = np.random.Generator(np.random.PCG64(child)).permutation(self.transform_size)
            place = shuffle[place]
        return place.astype(np.int64)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        x = np.ascontiguousarray(x)
        padded = np.zeros((len(x), self.transform_size), x.dtype)
        padded[:, self.position] = x
        signed = _core.hadamard(padded)[:, self.selected]
        # (H + 1) / 2 on the projector's pixels: the ones give each row's sum.
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
        # Sylvester's matrix holds (-1) to the number of bits that row and column share.
        return 1 - _odd_parity(row[:, None] & col[None, :]).astype(np.float32)

    @property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "hadamard",
            "shape": list(self.shape),
            "count": self.count,
            "order": self.order,
            "permute": self.permute,
            "seed": self.seed,
        }


def _power_of_two(size: int) -> int:
    return 1 << (size - 1).bit_length()


def _odd_parity(values: NDArray[np.int64]) -> NDArray[np.int64]:
    for shift in (32, 16, 8, 4, 2, 1):
        values = values ^ (values >> shift)
    return values & 1


def _sequency(size: int) -> NDArray[np.int64]:
    """Sign changes along each row of the Sylvester matrix of the given order."""
    index = np.arange(size)
    matrix = _odd_parity(index[:, None] & index[None, :])
    return np.abs(np.diff(matrix, axis=1)).sum(axis=1)


@dataclass(frozen=True, eq=False)
class ImagePatterns(PatternSet):
    """Patterns given as images of any grey values: a dense matrix.

    Parameters
    ----------
    stack : (K, rows, cols) float
        Grey values in [0, 1].
    """

    stack: NDArray[np.float32]

    def __post_init__(self) -> None:
        stack = self.stack
        if stack.ndim != 3:
            raise InputError(
                f"patterns of shape {stack.shape}", hint="give grey images as (K, rows, cols)"
            )
        check_geometry(stack.shape[1:], len(stack))
        if not np.isfinite(stack).all() or stack.min() < 0 or stack.max() > 1:
            raise InputError(
                "pattern values are not all within 0 and 1", hint="scale the patterns to [0, 1]"
            )
        object.__setattr__(self, "stack", np.ascontiguousarray(stack, np.float32))

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]
        return int(self.stack.shape[1]), int(self.stack.shape[2])

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.stack)

    @property
    def matrix(self) -> NDArray[np.float32]:
        """P itself, (K, N) float32."""
        return self.stack.reshape(self.count, -1)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(x @ self._matrix_as(x.dtype).T)

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(e @ self._matrix_as(e.dtype))

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return self.matrix[:, index]

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        return self.matrix[start:stop]

    def _matrix_as(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        return self._double if dtype == np.float64 else self.matrix

    @cached_property
    def _double(self) -> NDArray[np.float64]:
        return self.matrix.astype(np.float64)

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "images", "shape": list(self.shape), "count": self.count}


@dataclass(frozen=True, eq=False)
class BlockPatterns(PatternSet):
    """One block of projector pixels lit at a time; blocks of 1 x 1 are the one-pixel responses.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    block : (int, int)
        Rows and columns of a block; blocks at the border may be smaller.
    selected : (K,) int, optional
        Which blocks, in the order (block row, block col); None means all.
    """

    shape: tuple[int, int]
    block: tuple[int, int] = (1, 1)
    selected: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if min(self.block) < 1:
            raise InputError(f"a block of {self.block} pixels", hint="use at least 1 x 1")
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
        rows = np.arange(self.shape[0]) // self.block[0]
        cols = np.arange(self.shape[1]) // self.block[1]
        return (rows[:, None] * self.grid[1] + cols[None, :]).ravel().astype(np.int64)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        sums = self._membership(x.dtype) @ x.T
        return np.ascontiguousarray(np.asarray(sums)[self.index].T)

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        per_block = np.zeros((len(e), self.grid[0] * self.grid[1]), e.dtype)
        np.add.at(per_block.T, self.index, e.T)
        return per_block[:, self._block_of_pixel]

    def _membership(self, dtype: np.dtype[Any]) -> csr_array:
        pixels = np.arange(self.pixels)
        entries = (np.ones(self.pixels, dtype), (self._block_of_pixel, pixels))
        return csr_array(entries, shape=(self.grid[0] * self.grid[1], self.pixels))

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return (self.index[:, None] == self._block_of_pixel[index][None, :]).astype(np.float32)

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        lit = self.index[start:stop, None] == self._block_of_pixel[None, :]
        return lit.astype(np.float32)

    @property
    def description(self) -> dict[str, Any]:
        selected = None if self.selected is None else [int(i) for i in self.index]
        return {
            "kind": "blocks",
            "shape": list(self.shape),
            "block": list(self.block),
            "selected": selected,
        }


def one_pixel_patterns(
    shape: tuple[int, int], selected: NDArray[np.integer] | None = None
) -> BlockPatterns:
    """One projector pixel lit at a time: the naive measurement of T, column by column."""
    index = None if selected is None else np.asarray(selected, np.int64)
    return BlockPatterns(shape, (1, 1), index)


def sampled_pixels(shape: tuple[int, int], step: int = 8, offset: int = 4) -> NDArray[np.int64]:
    """Projector pixels on a regular grid: 256 of a 128 x 128 projector, as in the paper's Fig. 6.

    Returns
    -------
    (count,) int64
        Flat indices of the pixels (offset + step i, offset + step j).
    """
    rows = np.arange(offset, shape[0], step)
    cols = np.arange(offset, shape[1], step)
    return (rows[:, None] * shape[1] + cols[None, :]).ravel().astype(np.int64)
