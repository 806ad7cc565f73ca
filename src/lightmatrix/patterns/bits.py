"""Black and white patterns, kept as bits: any such patterns, and random ones (Bernoulli)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.patterns import pattern_set
from lightmatrix.ranges import as_float, check_seed, real_array
from lightmatrix.resources.threads import computed_once

# The iterative solvers multiply the same patterns many times. A product of float matrices is then
# faster than sums of bits, if the matrix has at most _DENSE_BYTES and multiplies _DENSE_ROWS rows
# or more. Both are chosen by hand.
_DENSE_BYTES = 128 << 20
_DENSE_ROWS = 8


class BinaryPatterns(pattern_set.PatternSet):
    """Black and white patterns as bits, (K, ceil(N / 8)) uint8, least significant bit first."""

    bits: NDArray[np.uint8]
    has_matrix: ClassVar[bool] = True

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        if self._multiply_dense(x):
            return np.asarray(x @ self._dense.T)
        return _core.bits_forward(self.bits, self.pixels, np.ascontiguousarray(x))

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        if self._multiply_dense(e):
            return np.asarray(e @ self._dense)
        return _core.bits_adjoint(self.bits, self.pixels, np.ascontiguousarray(e))

    def _multiply_dense(self, rows: NDArray[Any]) -> bool:
        return self._is_small and rows.dtype == np.float32 and len(rows) >= _DENSE_ROWS

    @property
    def _is_small(self) -> bool:
        return 4 * self.count * self.pixels <= _DENSE_BYTES

    @computed_once
    def _dense(self) -> NDArray[np.float32]:
        return self.dense()

    @computed_once
    def sums(self) -> NDArray[np.float64]:
        lit = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1)
        # The last byte may be longer than the pattern. Nothing is left of one shifted by 8.
        beyond = lit[self.bits[:, -1] >> np.uint8(self.pixels % 8 or 8)]
        whole = lit.astype(np.uint8)[self.bits].sum(axis=1, dtype=np.float64)
        return np.asarray(whole - beyond)

    @computed_once
    def squares(self) -> NDArray[np.float64]:
        return self.weighted_sum(np.ones(self.count))

    def weighted_sum(self, weights: NDArray[np.floating]) -> NDArray[np.float64]:
        return _core.bits_adjoint(self.bits, self.pixels, np.ascontiguousarray(weights[None]))[0]

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return _core.bits_columns(self.bits, self.pixels, np.asarray(index, np.int64))

    def laid(self, pixels: NDArray[np.int64]) -> "BitPatterns":
        place = np.maximum(pixels, 0).ravel()
        lit = np.take(self.bits, place >> 3, axis=1)
        lit >>= (place & 7).astype(np.uint8)
        lit &= (pixels >= 0).ravel()
        return BitPatterns(pixels.shape, np.packbits(lit, axis=1, bitorder="little"))

    def span(self, start: int, stop: int) -> NDArray[np.float32]:
        if self._is_small:
            return self._dense[:, start:stop]
        lit = np.unpackbits(self.bits[:, start // 8 : -(-stop // 8)], axis=1, bitorder="little")
        return lit[:, start % 8 :][:, : stop - start].astype(np.float32)

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        return self._lit(start, stop).astype(np.float32)

    def greys(self, start: int, stop: int) -> NDArray[np.uint8]:
        return (self._lit(start, stop) * np.uint8(255)).reshape(-1, *self.shape)

    def _lit(self, start: int, stop: int) -> NDArray[np.uint8]:
        some = self.bits[start:stop]
        return np.unpackbits(some, axis=1, count=self.pixels, bitorder="little")

    def as_bits(self) -> NDArray[np.uint8]:
        return self.bits

    def subset(self, index: NDArray[np.integer]) -> pattern_set.PatternSet:
        return BitPatterns(self.shape, self.bits[np.asarray(index)])


@dataclass(frozen=True, eq=False, repr=False)
class BitPatterns(BinaryPatterns):
    """Black and white patterns given as bits, such as some patterns of another set.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    bits : (K, ceil(N / 8)) uint8
        Lit pixels, least significant bit first.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.BitPatterns((2, 4), np.array([[0b00001111], [0b01010101]], np.uint8)).images()[0]
    array([[1., 1., 1., 1.],
           [0., 0., 0., 0.]], dtype=float32)
    """

    shape: tuple[int, int]
    bits: NDArray[np.uint8]

    def __post_init__(self) -> None:
        bits = real_array("bits", self.bits)
        pattern_set.check_geometry(self.shape, len(bits) if bits.ndim else 0)
        if bits.dtype != np.uint8 or bits.shape[1:] != ((self.pixels + 7) // 8,):
            raise InputError(
                f"{bits.dtype} bits of shape {bits.shape} for a projector of shape {self.shape}",
                hint=f"give (K, {(self.pixels + 7) // 8}) bytes",
            )
        object.__setattr__(self, "bits", bits)

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.bits)


@dataclass(frozen=True, eq=False)
class BernoulliPatterns(BinaryPatterns):
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
        Seed of the draw; the same seed, shape and density give the same patterns on every machine.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((16, 24), count=32)
    >>> patterns.images().shape, patterns.pixels
    ((32, 16, 24), 384)
    """

    shape: tuple[int, int]
    count: int
    density: float = 0.5
    seed: int = 0

    kind: ClassVar[str] = "bernoulli"

    def __post_init__(self) -> None:
        check_random(self.shape, self.count, self.density, self.seed)

    @cached_property
    def bits(self) -> NDArray[np.uint8]:  # type: ignore[override]
        """Lit pixels, (K, ceil(N / 8)) uint8, least significant bit first."""
        return drawn_bits(self, self.density, self.seed)


def drawn_bits(
    patterns: pattern_set.PatternSet,
    density: float,
    seed: int,
    cells: Sequence[NDArray[np.int64]] | None = None,
) -> NDArray[np.uint8]:
    """Random bits of each pattern, whose cells (by its kind) are lit as a whole; None: pixels."""
    bits = np.empty((patterns.count, (patterns.pixels + 7) // 8), np.uint8)
    seeds = pattern_set.seed_sequence(seed, patterns.shape, density).spawn(patterns.count)
    # Each pattern has its own generator, so the first k do not depend on how many follow.
    for k, child in enumerate(seeds):
        cell = None if cells is None else cells[patterns.kinds[k]]
        count = patterns.pixels if cell is None else int(cell[-1]) + 1
        lit = np.random.Generator(np.random.PCG64(child)).random(count) < density
        bits[k] = np.packbits(lit if cell is None else lit[cell], bitorder="little")
    return bits


def check_random(shape: tuple[int, int], count: int, density: float, seed: int) -> None:
    """Refuse projectors, counts, densities and seeds of which no random patterns can be drawn."""
    pattern_set.check_geometry(shape, count)
    check_seed(seed)
    if not 0 < as_float(density) < 1:
        raise InputError(f"a density of {density}", hint="use a share between 0 and 1, such as 0.5")


def with_white(patterns: pattern_set.PatternSet) -> pattern_set.PatternSet:
    """The patterns and a white one after them, as bits if they are black and white."""
    bits = patterns.as_bits()
    if bits is None:
        white = np.ones((1, *patterns.shape), np.float32)
        return pattern_set.ImagePatterns(np.concatenate([patterns.images(), white]))
    lit = np.packbits(np.ones((1, patterns.pixels), bool), axis=1, bitorder="little")
    return BitPatterns(patterns.shape, np.concatenate([bits, lit]))
