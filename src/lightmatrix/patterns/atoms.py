"""Atoms: spots of light of several sizes as further columns of a pattern set.

A projector out of focus, or a camera pixel that sees many projector pixels, makes footprints of
dozens of pixels, each too faint to be estimated by itself. As one spot it is strong. The sample
of a spot under a pattern is the blurred pattern at its place.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import computed_once

# Rows whose spots become pixels at a time, which bounds memory: the widest spot has 500 pixels.
_EXPANDED_ROWS = 4096


@dataclass(frozen=True, eq=False)
class AtomPatterns(PatternSet):
    """K patterns over S N atoms: a spot of each of S sizes at each of N projector pixels.

    Column s N + j is the sample of a spot around pixel j: the pattern blurred by the kernel of size
    s, times a gain that gives all sizes the same contrast. The penalty on a spot is then in
    proportion to the samples that it can explain. Light beyond the projector is lost.
    """

    # The K patterns over N single pixels.
    single: PatternSet
    # Standard deviations in projector pixels, ascending from 0, a single pixel.
    sizes: tuple[float, ...]
    # One in (0, 1] for each size; empty: from the contrast of the patterns.
    gains: tuple[float, ...] = ()
    # The compiled solver keeps columns in half the memory, to within 1e-5.
    narrow: bool = False
    # Whether contrast is what differs from even light. Else it has what spots lose at the border,
    # which is three times their contrast where these are wide.
    even: bool = False
    # The only atoms that are prepared for the compiled solver, ascending; None: all.
    wanted: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        sizes = self.sizes
        if not sizes or sizes[0] != 0 or not all(a < b for a, b in pairwise(sizes)):
            raise InputError(f"spots of sizes {sizes}", hint="let sizes ascend from 0")
        if not self.gains:
            others = (self.contrast(plane) for plane in range(1, len(sizes)))
            lengths = np.array([self.single_contrast, *others])
            shares = lengths.min() / lengths if lengths.min() > 0 else np.ones(len(sizes))
            object.__setattr__(self, "gains", tuple(float(share) for share in shares))
        elif len(self.gains) != len(sizes) or not all(0 < gain <= 1 for gain in self.gains):
            raise InputError(f"gains of {self.gains}", hint="give one in (0, 1] for each size")

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]
        return self.single.shape

    @property
    def count(self) -> int:  # type: ignore[override]
        return self.single.count

    @property
    def pixels(self) -> int:
        """Number of atoms, S N."""
        return len(self.sizes) * self.single.pixels

    @property
    def planes(self) -> int:
        """Number of sizes S."""
        return len(self.sizes)

    @computed_once
    def kernels(self) -> tuple[NDArray[np.float32], ...]:
        """One side of each separable kernel, from its middle outwards; each sums to 1."""
        return tuple(_kernel(size) for size in self.sizes)

    @computed_once
    def spots(self) -> list[NDArray[np.float32]]:
        """One side of each kernel over its middle, in [0, 1]."""
        return [kernel / kernel[0] for kernel in self.kernels]

    @computed_once
    def single_contrast(self) -> float:
        """Standard deviation of the values of the single pixels' patterns."""
        return self.contrast(0)

    @computed_once
    def neighbour_contrast(self) -> float:
        """Contrast between neighbouring pixels, at most `single_contrast`, which it is if random.

        Under smooth patterns light that is taken for a neighbour's hardly changes a photograph. The
        finest quarter of the patterns decides, since these tell neighbours apart.
        """
        shares: list[float] = []
        step = max(1, min(self.shape) // 256)
        for _, chunk in self.single.chunks():
            for image in chunk.reshape(-1, *self.shape):
                steps = np.diff(image[::step], axis=1), np.diff(image[:, ::step], axis=0)
                square = np.mean([np.mean(each**2) for each in steps if each.size] or [np.inf])
                shares.append(float(square) / (2 * max(float(image.var()), 1e-12)))
        return self.single_contrast * float(np.sqrt(min(1.0, np.quantile(shares, 0.75))))

    @property
    def means(self) -> NDArray[np.float64]:
        """Means of the patterns, not of the atoms: the samples of light from everywhere, (K,)."""
        return self.single.means

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        planes = np.asarray(x).reshape(len(x), self.planes, self.single.pixels)
        spread = [self._scaled(planes[:, s], s) for s in range(self.planes)]
        return self.single.forward(np.sum(spread, axis=0, dtype=x.dtype))

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        single = self.single.adjoint(e)
        return np.concatenate([self._scaled(single, s) for s in range(self.planes)], axis=1)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        return np.concatenate([chunk[:, index] for _, chunk in self.chunks()])

    def part(self, pixels: NDArray[np.int64] | None = None, every: int = 1) -> "AtomPatterns":
        """The atoms, of every so-manieth size, over the pixels at some places, (h, w); see `Sheet`.

        Columns are those of the whole where all pixels under a spot are there. None: all pixels.
        """
        single = self.single if pixels is None else self.single.laid(pixels)
        return AtomPatterns(single, self.sizes[::every], self.gains[::every], self.narrow)

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        single = self.single.rows(start, stop)
        return np.concatenate([self._scaled(single, s) for s in range(self.planes)], axis=1)

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "atoms", "sizes": list(self.sizes), "single": self.single.description}

    def prepare(
        self, column: NDArray[Any] | None = None, instructions: str | None = None
    ) -> _core.PreparedPatterns:
        single = self.single.prepare(column, instructions)
        planes = [(k, float(gain)) for k, gain in zip(self.kernels, self._gain, strict=True)]
        return single.atoms(self.shape, planes, self.narrow, self.wanted)

    def centres(self, rows: csr_array) -> csr_array:
        """Coefficients (M, S N) as light at the middles of their spots, (M, N)."""
        plane, pixel = np.divmod(rows.indices, self.single.pixels)
        light = (rows.data * self._gain[plane]).astype(np.float32)
        shape = (rows.shape[0], self.single.pixels)
        # Adding duplicates changes the parts in place.
        middles = csr_array((light, pixel, rows.indptr.copy()), shape=shape)
        middles.sum_duplicates()
        return middles

    def expand(self, rows: csr_array) -> csr_array:
        """Coefficients (M, S N) as light of pixels, (M, N) float32, without a spot's faintest."""
        starts = range(0, rows.shape[0], _EXPANDED_ROWS)
        parts = [self._expanded(rows[start : start + _EXPANDED_ROWS]) for start in starts]
        return csr_array(vstack(parts, format="csr"))

    def _expanded(self, rows: csr_array) -> csr_array:
        """Some of the rows of `expand`, for which only their own spots are drawn."""
        n = self.single.pixels
        whole = csr_array(rows[:, :n] * self._gain[0])
        for s in range(1, self.planes):
            part = csr_array(rows[:, s * n : (s + 1) * n] * self._gain[s])
            if part.nnz:
                used, place = np.unique(part.indices, return_inverse=True)
                shape = (part.shape[0], len(used))
                whole = whole + csr_array((part.data, place, part.indptr), shape=shape) @ (
                    self._drawn(used, s)
                )
        whole = csr_array(whole, dtype=np.float32)
        whole.sort_indices()
        return whole

    @property
    def _gain(self) -> NDArray[np.float32]:
        return np.asarray(self.gains, np.float32)

    def _drawn(self, pixels: NDArray[np.integer], plane: int) -> csr_array:
        """Pixels of the spots of a size around the given m pixels, (m, N) float32."""
        spot = self.spots[plane]
        both = np.concatenate([spot[:0:-1], spot])
        whole = np.outer(both, both)
        # Pixels of a spot are left out if they are fainter than this share of its middle. Chosen by
        # hand: smaller values store more non-zeros, larger ones change the shape of the spot.
        down, right = np.nonzero(whole >= 1e-3)
        # A spot at the border is as bright as one in the middle, and loses what lies beyond.
        light = whole[down, right] / np.float32(whole[down, right].sum())
        row = pixels[:, None] // self.shape[1] + (down - len(spot) + 1)
        col = pixels[:, None] % self.shape[1] + (right - len(spot) + 1)
        inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        places = (row * self.shape[1] + col)[inside]
        ends = np.append(0, np.cumsum(inside.sum(axis=1)))
        data = np.broadcast_to(light, inside.shape)[inside]
        return csr_array((data, places, ends), shape=(len(pixels), self.single.pixels))

    def _scaled(self, x: NDArray[Any], plane: int) -> NDArray[Any]:
        """Rows (m, N) under a kernel, times its gain, in their dtype."""
        images = x.reshape(-1, *self.shape)
        kernel = self.kernels[plane]
        if len(kernel) > 1:
            whole = np.concatenate([kernel[:0:-1], kernel])
            for axis in (1, 2):
                images = scipy.ndimage.convolve1d(images, whole, axis=axis, mode="constant")
        return np.asarray(images.reshape(x.shape) * self.gains[plane], x.dtype)

    def contrast(self, plane: int) -> float:
        """Standard deviation of the values of the columns of a size, without gain."""
        kernel = self.kernels[plane]
        chunks: Iterable[NDArray[Any]] = (chunk for _, chunk in self.single.chunks())
        if self.even:
            chunks = (chunk - chunk.mean(axis=1, keepdims=True) for chunk in chunks)
        parts = [_core.blurred_moments(c, self.shape, kernel) for c in chunks]
        total, squares = np.sum(parts, axis=0) / (self.count * self.single.pixels)
        return float(np.sqrt(max(squares - total**2, 0.0)))


# Rows and columns of projector pixels.
Box = tuple[slice, ...]
# The side in projector pixels of the cells that boxes consist of. Chosen by hand.
_CELL = 16


def boxes_around(pixels: NDArray[np.integer], shape: tuple[int, int]) -> list[Box]:
    """Boxes that hold some pixels of a projector; pixels in cells side by side share one.

    The first cell stands for none, as rows without light are solved too.
    """
    lit = np.zeros([-(-n // _CELL) for n in shape], bool)
    lit[0, 0] = not len(pixels)
    lit.ravel()[_cells(pixels, shape)] = True
    found = scipy.ndimage.find_objects(scipy.ndimage.label(lit, np.ones((3, 3)))[0])
    return [tuple(slice(s.start * _CELL, s.stop * _CELL) for s in box) for box in found]


def _cells(pixels: NDArray[np.integer], shape: tuple[int, int]) -> NDArray[np.int64]:
    row, col = np.divmod(pixels, shape[1])
    return row // _CELL * -(-shape[1] // _CELL) + col // _CELL


@dataclass(frozen=True, eq=False)
class Sheet:
    """Boxes of projector pixels side by side, each within a margin of further pixels.

    Where there are too many pixels to keep all atoms, those on a sheet are made, solved and lifted.
    """

    # Rows and columns of the projector.
    shape: tuple[int, int]
    # The projector pixel at each place, (h, w); -1 beyond the projector.
    pixels: NDArray[np.int64]
    # The place of a pixel (row, col) of a cell is row w + col + shift; far below 0 without a box.
    shifts: NDArray[np.int64]

    @classmethod
    def of(cls, boxes: Sequence[Box], shape: tuple[int, int], margin: int) -> "Sheet":
        """The sheet of some boxes."""
        boxes = sorted(boxes, key=lambda box: box[0].start - box[0].stop)
        sizes = [[side.stop - side.start + 2 * margin for side in box] for box in boxes]
        # About as wide as high. Boxes stand on shelves, the highest on the first.
        width = max(int(sum(high * wide for high, wide in sizes) ** 0.5), *(w for _, w in sizes))
        top, left, bottom, corners = 0, 0, 0, []
        for high, wide in sizes:
            if left + wide > width:
                top, left = bottom, 0
            corners.append((top, left))
            left, bottom = left + wide, max(bottom, top + high)
        pixels = np.full((bottom, width), -1)
        shifts = np.full([-(-n // _CELL) for n in shape], -(1 << 60))
        for (top, left), (high, wide), (rows, cols) in zip(corners, sizes, boxes, strict=True):
            row = np.arange(high)[:, None] + rows.start - margin
            col = np.arange(wide) + cols.start - margin
            inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
            place = np.s_[top : top + high, left : left + wide]
            pixels[place] = np.where(inside, row * shape[1] + col, -1)
            cells = tuple(slice(s.start // _CELL, s.stop // _CELL) for s in (rows, cols))
            shifts[cells] = (top + margin - rows.start) * width + left + margin - cols.start
        return cls(shape, pixels, shifts.ravel())

    @classmethod
    def whole(cls, shape: tuple[int, int]) -> "Sheet":
        """All pixels in their own places."""
        pixels = np.arange(shape[0] * shape[1]).reshape(shape)
        return cls(shape, pixels, np.zeros([-(-n // _CELL) for n in shape], np.int64).ravel())

    def laid(self, rows: csr_array) -> csr_array:
        """Rows of the projector's atoms, (m, S N), as those of the sheet's, without all others."""
        whole = self.shape[0] * self.shape[1]
        plane, pixel = np.divmod(rows.indices, whole)
        row, col = np.divmod(pixel, self.shape[1])
        place = row * self.pixels.shape[1] + col + self.shifts[_cells(pixel, self.shape)]
        index = np.maximum(place, 0) + plane * np.int64(self.pixels.size)
        parts = np.where(place >= 0, rows.data, 0), index, rows.indptr.copy()
        laid = csr_array(parts, (rows.shape[0], rows.shape[1] // whole * self.pixels.size))
        laid.eliminate_zeros()
        laid.sort_indices()
        return laid

    def lifted(self, rows: csr_array, planes: int, every: int = 1) -> csr_array:
        """Rows of the sheet's atoms, of every so-manieth size, as those of the projector's."""
        whole = self.shape[0] * self.shape[1]
        plane, place = np.divmod(rows.indices, self.pixels.size)
        index = plane * np.int64(every * whole) + self.pixels.ravel()[place]
        lifted = csr_array((rows.data, index, rows.indptr), (rows.shape[0], planes * whole))
        lifted.sort_indices()
        return lifted


def _kernel(size: float) -> NDArray[np.float32]:
    # Standard deviations that a kernel reaches to each side; beyond lies 0.3 % of a Gaussian.
    offsets = np.arange(int(3.0 * size + 0.5) + 1)
    kernel = np.exp(-0.5 * (offsets / size) ** 2) if size > 0 else np.ones(1)
    return np.asarray(kernel / (2 * kernel.sum() - kernel[0]), np.float32)
