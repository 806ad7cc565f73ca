"""`PatternSet`: the patterns that the projector shows, as a linear operator.

A set of K patterns over N projector pixels is the matrix P (K, N) with entries in [0, 1]. Rows of
the light transport matrix are estimated in batches, so the operators act on rows:

    forward:  (M, N) -> (M, K)   samples = X P'
    adjoint:  (M, K) -> (M, N)   correlations = E P

Every set has a `description`, from which `patterns/making.py` remakes it, and a `digest` of its
content, which ties captures and estimates to their patterns.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeVar, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.patterns.inverse import Inverse, inverse_of
from lightmatrix.ranges import check_sides, check_whole, real_array
from lightmatrix.reprs import ShortRepr, jsonable
from lightmatrix.resources.threads import computed_once, work_ahead

# The longest side of a bin in pixels, more than any camera or projector has.
_LARGEST_BLOCK = 1 << 20


def block_size(block: int | tuple[int, int], what: str) -> tuple[int, int]:
    """Rows and columns of a block of `what` pixels, given as such or as one number for both."""
    rows, cols = (block, block) if isinstance(block, (int, np.integer)) else block
    if not 1 <= min(rows, cols) <= max(rows, cols) <= _LARGEST_BLOCK:
        hint = f"use 1 to {_LARGEST_BLOCK}, such as 8"
        raise InputError(f"the {what} binned by {rows} x {cols} pixels", hint=hint)
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


# Pixels at most this far apart, in rows and columns, count as one: camera pixels often see both.
NEAR = 1
# Values that differ by less than 2 % are the same.
SAME = 0.02


def groups(mixed: NDArray[np.float64]) -> NDArray[np.int64]:
    """The number of each pixel's group of pixels of the same mixture, (N,)."""
    order = np.argsort(mixed, kind="stable")
    # Mixtures of values that differ by less than this share are the same but for rounding.
    step = np.diff(mixed[order]) >= 1e-9 * max(1.0, float(np.abs(mixed).max()))
    group = np.empty(len(mixed), np.int64)
    group[order] = np.concatenate([[0], np.cumsum(step)])
    return group


def seed_sequence(
    seed: int, shape: tuple[int, int], density: float = 0.5
) -> np.random.SeedSequence:
    """The source of random patterns, which have nothing in common with those of another shape.

    Otherwise patterns of another size and the same seed would explain photographs, and give a
    wrong T.
    """
    # Zeros at the end change nothing, so that a seed gives the patterns of 64 x 64 pixels, half of
    # them lit, with which the numbers in the documentation were measured.
    rows, cols, share = shape[0] ^ 64, shape[1] ^ 64, int(density * 2**32) ^ 2**31
    return np.random.SeedSequence([seed, rows, cols, share])


T = TypeVar("T")

# Bytes of patterns that are unpacked at a time, as float32. Chosen by hand: little beside the
# memory of an estimate, and still 16 patterns of a megapixel.
_CHUNK_BYTES = 64 << 20
# Correlations take at most 64 MiB at a time where the fast product is that with all pixels, and are
# those of 8192 pixels at a time, which caches hold, where it is one of matrices. Chosen by hand.
_CORRELATION_BYTES, _PIXELS_AT_ONCE = 64 << 20, 1 << 13
# The most patterns of a set. Nobody takes so many photographs; a larger number is a typing error.
_MOST_PATTERNS = 1_000_000


class PatternSet(ShortRepr, ABC):
    """K patterns over a projector of (rows, cols) pixels.

    Attributes
    ----------
    shape : (int, int)
        Projector rows and columns; N = rows * cols.
    count : int
        Number of patterns K.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((8, 8), 4)
    >>> isinstance(patterns, lm.PatternSet), patterns.forward(np.ones((1, 64))).shape
    (True, (1, 4))
    """

    shape: tuple[int, int]
    count: int
    # The name of sets that their parameters remake; "images" are only in their images.
    kind: ClassVar[str] = "images"
    # Whether parts of the matrix are at hand, so that products with them are fast.
    has_matrix: ClassVar[bool] = False

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

    def at(self, pixels: NDArray[np.integer]) -> NDArray[np.float32]:
        """Values at pixels in an array of any shape: (K, *pixels.shape) float32."""
        return self.columns(pixels.ravel()).reshape(self.count, *pixels.shape)

    def laid(self, pixels: NDArray[np.int64]) -> "PatternSet":
        """The patterns on a sheet of some of their pixels, (h, w); places of -1 are dark."""
        return ImagePatterns(self.at(np.maximum(pixels, 0)) * (pixels >= 0))

    def span(self, start: int, stop: int) -> NDArray[np.float32]:
        """Columns start..stop of P: (K, stop - start) float32."""
        return self.columns(np.arange(start, stop))

    def correlations(
        self, e: NDArray[Any], use: Callable[[slice, slice, NDArray[Any]], T]
    ) -> Iterator[T]:
        """Use the `adjoint` of e (M, K) part by part, in order; threads work on several at a time.

        `use` gets some rows, some pixels, and theirs of e P, which it may overwrite.
        """

        def used(part: tuple[slice, slice]) -> T:
            rows, pixels = part
            if self.has_matrix:
                return use(rows, pixels, e[rows] @ self.span(pixels.start, pixels.stop))
            return use(rows, pixels, self.adjoint(e[rows]))

        if self.has_matrix:
            parts = [(slice(0, len(e)), part) for part in _cut(self.pixels, _PIXELS_AT_ONCE)]
        else:
            size = max(1, _CORRELATION_BYTES // (e.itemsize * self.pixels))
            parts = [(part, slice(0, self.pixels)) for part in _cut(len(e), size)]
        return work_ahead(used, parts)

    @abstractmethod
    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        """Patterns start..stop of P as float32 (stop - start, N)."""

    @property
    def description(self) -> dict[str, Any]:
        """The parameters that remake the set, JSON-ready, with its ``kind``."""
        if self.kind == "images":
            return {"kind": self.kind, "shape": list(self.shape), "count": self.count}
        parameters = {each.name: getattr(self, each.name) for each in fields(cast(Any, self))}
        return {"kind": self.kind, **json.loads(json.dumps(parameters, default=jsonable))}

    @computed_once
    def sums(self) -> NDArray[np.float64]:
        """Sum of each pattern over its pixels, (K,) float64."""
        return np.concatenate([chunk.sum(axis=1, dtype=np.float64) for _, chunk in self.chunks()])

    @computed_once
    def means(self) -> NDArray[np.float64]:
        """Mean of each pattern, (K,) float64."""
        return self.sums / self.pixels

    @computed_once
    def kinds(self) -> NDArray[np.int64]:
        """The kind of each pattern, (K,): all are of one kind, except in a mix."""
        return np.zeros(self.count, np.int64)

    @property
    def digest(self) -> str:
        """Hash of the patterns' content (8-bit grey, as projected) and shape, 16 hex digits."""
        return self._digests[0]

    @property
    def digests(self) -> list[str]:
        """The same of each pattern, which show which set a pattern belongs to."""
        return self._digests[1]

    @computed_once
    def _digests(self) -> tuple[str, list[str]]:
        hasher, each = hashlib.sha256(repr((self.shape, self.count)).encode()), list[str]()
        for k in range(self.count):
            content = self.greys(k, k + 1).tobytes()
            hasher.update(content)
            each.append(hashlib.sha256(repr(self.shape).encode() + content).hexdigest()[:16])
        return hasher.hexdigest()[:16], each

    def chunks(self) -> Any:
        """Iterate over (start, rows of P) in chunks of bounded memory."""
        size = max(1, _CHUNK_BYTES // (4 * self.pixels))
        for start in range(0, self.count, size):
            yield start, self.rows(start, min(start + size, self.count))

    @computed_once
    def contrasts(self) -> NDArray[np.float64]:
        """Squared norm of each pixel's values, less what follows the patterns' means, (N,)."""
        along = self.weighted_sum(self.means)
        return np.maximum(self.squares - along**2 / max(float(self.means @ self.means), 1e-300), 0)

    @computed_once
    def squares(self) -> NDArray[np.float64]:
        """Squared norm of each pixel's values, (N,)."""
        total = np.zeros(self.pixels)
        for _, chunk in self.chunks():
            total += np.einsum("kn,kn->n", chunk, chunk)
        return total

    def weighted_sum(self, weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """The sum of all patterns, each times its weight of (K,): (N,)."""
        total = np.zeros(self.pixels)
        for start, chunk in self.chunks():
            total += weights[start : start + len(chunk)] @ chunk.astype(np.float64)
        return total

    @computed_once
    def axes(self) -> tuple[bool, bool]:
        """Whether any pattern varies along rows, and along columns."""
        varies = [False, False]
        for _, chunk in self.chunks():
            images = chunk.reshape(-1, *self.shape)
            for axis in (0, 1):
                varies[axis] |= bool((np.ptp(images, axis=1 + axis) > SAME).any())
            if all(varies):
                break
        return varies[0], varies[1]

    @computed_once
    def twins(self) -> NDArray[np.int64]:
        """The number of each pixel's group: pixels that all patterns show alike, (N,)."""
        return groups(self._mixture)

    @computed_once
    def alike_surroundings(self) -> NDArray[np.bool_]:
        """Whether all patterns show a pixel and its neighbours like those farther away, (N,)."""
        corner, beside, above, centre = np.random.default_rng(1).standard_normal(4)
        kernel = [[corner, above, corner], [beside, centre, beside], [corner, above, corner]]
        # A mixture with the neighbours is the same where the surroundings are, also if mirrored.
        mixed = scipy.ndimage.convolve(
            self._mixture.reshape(self.shape), np.array(kernel), mode="nearest"
        )
        group, far = groups(mixed.ravel()), np.zeros(self.pixels, np.bool_)
        # Whether a pixel of the same group lies more than a pixel away along one of the axes.
        places = np.divmod(np.arange(self.pixels), self.shape[1])
        for place in (place for place, varies in zip(places, self.axes, strict=True) if varies):
            for away in (place, -place):
                least = np.full(int(group.max()) + 1, np.iinfo(np.int64).max)
                np.minimum.at(least, group, away)
                far |= away - least[group] > NEAR
        return far

    @property
    def _mixture(self) -> NDArray[np.float64]:
        """A random mixture of all patterns, (N,): pixels that all show alike have the same."""
        return self.weighted_sum(np.random.default_rng(0).standard_normal(self.count))

    def images(self, start: int = 0, stop: int | None = None) -> NDArray[np.float32]:
        """Patterns as images: (stop - start, rows, cols) float32 in [0, 1]."""
        rows = self.rows(start, self.count if stop is None else stop)
        return rows.reshape(-1, *self.shape)

    def dense(self) -> NDArray[np.float32]:
        """The whole of P, (K, N) float32; for small sets and tests."""
        return self.rows(0, self.count)

    @computed_once
    def gram(self) -> NDArray[np.float64]:
        """P P', (K, K) float64."""
        dense = np.empty((self.count, self.count))
        for start, chunk in self.chunks():
            stop = start + len(chunk)
            dense[start:stop] = self.forward(chunk.astype(np.float64))
        return dense

    def coarse(self, block: tuple[int, int]) -> "ImagePatterns":
        """The patterns averaged over blocks of (rows, cols) projector pixels.

        Blocks at the border may be smaller.
        """
        block = block_size(block, "projector")
        parts = [
            block_mean(part.reshape(-1, *self.shape), block).astype(np.float32)
            for _, part in self.chunks()
        ]
        return ImagePatterns(np.concatenate(parts))

    def greys(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Patterns as images of the 8-bit grey values that are projected: (n, rows, cols)."""
        return to_grey(self.images(start, stop))

    @property
    def transform(self) -> tuple[int, NDArray[np.int64], NDArray[np.int64]] | None:
        """The fast transform that multiplies by P, if there is one.

        It has a length, the rows of it that are the patterns, (K,), and the place of each pixel in
        it, (N,).
        """
        return None

    def as_bits(self) -> NDArray[np.uint8] | None:
        """The patterns as bits, (K, ceil(N / 8)) uint8, if all are black and white; else None.

        The least significant bit comes first.
        """
        packed = []
        for _, chunk in self.chunks():
            lit = chunk == 1
            if not (lit | (chunk == 0)).all():
                return None
            packed.append(np.packbits(lit, axis=1, bitorder="little"))
        return np.concatenate(packed)

    @computed_once
    def inverted(self) -> Inverse | None:
        """How T follows from samples, if the patterns determine it; else None."""
        return inverse_of(self)

    @computed_once
    def prepared(self) -> _core.PreparedPatterns:
        """The set as the compiled solver uses it, made once for all tiles of a capture."""
        return self.prepare()

    def prepare(
        self, column: NDArray[Any] | None = None, instructions: str | None = None
    ) -> _core.PreparedPatterns:
        """The set as the compiled solver uses it.

        `column`, (K,), is the background's sample under each pattern; None: the pattern's mean.
        `instructions` are "portable", "avx2", "avx512" or "amx"; None: the best of this CPU. All
        give the same scores.
        """
        means = np.ascontiguousarray(self.means if column is None else column, np.float64)
        bits = self.as_bits()
        if bits is None:
            matrix = np.ascontiguousarray(self.dense())
            return _core.PreparedPatterns.from_dense(matrix, means, instructions)
        return _core.PreparedPatterns.from_bits(
            bits, self.pixels, means, self.transform, instructions
        )

    def subset(self, index: NDArray[np.integer]) -> "PatternSet":
        """The patterns of the given indices, as a set of their own."""
        index = np.asarray(index)
        return ImagePatterns(np.stack([self.images(int(k), int(k) + 1)[0] for k in index]))


def _cut(length: int, size: int) -> list[slice]:
    """Parts of at most `size`."""
    return [slice(start, min(start + size, length)) for start in range(0, length, size)]


def to_grey(patterns: NDArray[Any]) -> NDArray[np.uint8]:
    """Patterns in [0, 1] as the 8-bit grey values that are projected."""
    return np.rint(np.asarray(patterns, np.float32) * 255).astype(np.uint8)


def check_geometry(shape: tuple[int, int], count: int) -> None:
    """Refuse projectors without pixels and sets without patterns."""
    check_sides("a projector", shape)
    hint = f"ask for at least 1, and at most {_MOST_PATTERNS}"
    check_whole("patterns", count, most=_MOST_PATTERNS, hint=hint)


@dataclass(frozen=True, eq=False, repr=False)
class ImagePatterns(PatternSet):
    """Patterns given as images of any grey values: a dense matrix.

    Parameters
    ----------
    stack : (K, rows, cols) float
        Grey values in [0, 1].

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.ImagePatterns(np.linspace(0, 1, 24).reshape(2, 3, 4))
    ImagePatterns(stack=<2 x 3 x 4 float32>)
    """

    stack: NDArray[np.float32]

    has_matrix: ClassVar[bool] = True

    def __post_init__(self) -> None:
        stack = real_array("patterns", self.stack)
        if stack.ndim != 3:
            hint = "give grey images as (K, rows, cols)"
            raise InputError(f"patterns of shape {stack.shape}", hint=hint)
        check_geometry(stack.shape[1:], len(stack))
        if not np.isfinite(stack).all() or stack.min() < 0 or stack.max() > 1:
            hint = "scale the patterns to [0, 1]"
            raise InputError("pattern values are not all within 0 and 1", hint=hint)
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

    def span(self, start: int, stop: int) -> NDArray[np.float32]:
        return self.matrix[:, start:stop]

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        return self.matrix[start:stop]

    def _matrix_as(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        return self._double if dtype == np.float64 else self.matrix

    @computed_once
    def _double(self) -> NDArray[np.float64]:
        return self.matrix.astype(np.float64)
