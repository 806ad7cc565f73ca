"""The spots of each row of T: the few places on the projector where its light concentrates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import footprint_sizes, row_blocks

# Which spots of neighbouring camera pixels lie near each other on the projector.


Places = tuple[slice, slice, slice]


class NearSpots(NamedTuple):
    """One neighbour of all camera pixels that have it.

    `here` are those pixels and `there` their neighbours, in images (SPOTS, rows, cols) of spots.
    `near` (SPOTS, SPOTS, ..., ...) says which spot here, first axis, lies near which spot there.
    """

    here: Places
    there: Places
    near: NDArray[np.bool_]


def near_spots(
    place: NDArray[np.float64], shape: tuple[int, int], *, reach: int, radius: float
) -> Iterator[NearSpots]:
    """For each neighbour up to `reach` pixels away, the spots within `radius` of each other.

    `place` (P, SPOTS, 2) are rows and columns on the projector, NaN where there is no spot.
    """
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    row, col = as_images(place[..., 0], shape), as_images(place[..., 1], shape)
    steps = range(-reach, reach + 1)
    for down, right in ((d, r) for d in steps for r in steps if d or r):
        here = slice(None), _inside(shape[0], -down), _inside(shape[1], -right)
        there = slice(None), _inside(shape[0], down), _inside(shape[1], right)
        # In place, as these are the largest arrays of a separation.
        squared = (row[there] - row[here][:, None]) ** 2
        squared += (col[there] - col[here][:, None]) ** 2
        # Comparisons with NaN are False.
        yield NearSpots(here, there, squared <= radius**2)


def as_images(values: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Values (P, SPOTS) of spots as images (SPOTS, rows, cols)."""
    return np.ascontiguousarray(values.T).reshape(-1, *shape)


def by_pixel(images: NDArray[Any]) -> NDArray[Any]:
    """Images (SPOTS, rows, cols) as values (P, SPOTS)."""
    return np.ascontiguousarray(images.reshape(len(images), -1).T)


def _inside(size: int, by: int) -> slice:
    """The part of an axis that still lies inside once it is moved back by so many pixels."""
    return slice(max(0, by), size - max(0, -by))


# Spots that are searched in each row. A pixel on a depth edge sees two surfaces; the third place is
# for global light that outshines one of them.
SPOTS = 3
# Entries of T that are handled at a time, so that temporary arrays stay below 1 GB.
ENTRIES = 1 << 22
# Entries below this share of a row's largest one do not count in the size of its spot, where the
# estimate does not state one: they are mostly global light. Chosen by hand.
_FAINT = 0.05


@dataclass(frozen=True, eq=False)
class Spots:
    """The strongest spots of P camera pixels, up to `SPOTS` each, the strongest first.

    `place` (P, SPOTS, 2) is the centre of each spot as row and column of the projector, NaN where
    there is none; `light` (P, SPOTS) what it holds; `total` (P,) is the light of the whole row.
    """

    place: NDArray[np.float64]
    light: NDArray[np.float64]
    total: NDArray[np.float64]


def spot_deviation(transport: LightTransport, matrix: csr_array) -> float:
    """Standard deviation of a usual spot in projector pixels, from the median footprint.

    A Gaussian spot of standard deviation s has a footprint of 4 pi s^2 projector pixels.
    """
    sizes = np.asarray(transport.diagnostics.get("footprint", np.full(1, np.nan)), float)
    known = sizes[np.isfinite(sizes) & (sizes > 0)]
    if not known.size:
        peak = np.asarray(matrix.max(axis=1).toarray(), float).ravel()
        owner = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        bright = np.where(matrix.data >= _FAINT * peak[owner], matrix.data, 0)
        sizes = footprint_sizes(csr_array((bright, matrix.indices, matrix.indptr), matrix.shape))
        known = sizes[sizes > 0]
    return float(np.sqrt(np.median(known) / (4 * np.pi))) if known.size else 0.0


def find_spots(
    matrix: csr_array, background: NDArray[np.float64], width: int, radius: float
) -> Spots:
    """Find the strongest spots of each row; a spot is what lies within `radius` of its peak."""
    count = int(matrix.shape[0])
    place = np.full((count, SPOTS, 2), np.nan)
    light, total = np.zeros((count, SPOTS)), np.zeros(count)
    cuts = row_blocks(matrix.indptr, ENTRIES)
    for start, stop in pairwise(cuts):
        rows = slice(int(start), int(stop))
        part = csr_array(matrix[rows])
        place[rows], light[rows], total[rows] = _of_block(part, width, radius)
    return Spots(place, light, total + background)


def entries_of(
    matrix: csr_array, width: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """The row number of each entry; row and column of its projector pixel."""
    owner = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    row, col = np.divmod(matrix.indices, np.int32(width))
    return owner, row.astype(np.float64), col.astype(np.float64)


def _of_block(
    matrix: csr_array, width: int, radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Places, light and total light of the spots of some rows."""
    count = int(matrix.shape[0])
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    owner, row, col = entries_of(matrix, width)
    left = matrix.data.astype(np.float64)
    total = np.bincount(owner, left, count).astype(np.float64)
    place, light = np.full((count, SPOTS, 2), np.nan), np.zeros((count, SPOTS))
    for number in range(SPOTS):
        peak = np.zeros(count)
        np.maximum.at(peak, owner, left)
        strongest = np.full(count, -1, np.int64)
        at_peak = np.flatnonzero((left == peak[owner]) & (left > 0))
        # In reverse order, so that the first of several equal entries stays.
        strongest[owner[at_peak[::-1]]] = at_peak[::-1]
        valid = strongest >= 0
        if not valid.any():
            break
        middle_row, middle_col = (np.where(valid, axis[strongest], np.inf) for axis in (row, col))
        down, right = row - middle_row[owner], col - middle_col[owner]
        near = np.flatnonzero(down * down + right * right <= radius**2)
        rows, held = owner[near], left[near]
        own = np.bincount(rows, held, count)
        light[:, number] = own
        for axis, (middle, away) in enumerate(((middle_row, down), (middle_col, right))):
            shift = np.bincount(rows, held * away[near], count)
            place[valid, number, axis] = middle[valid] + shift[valid] / own[valid]
        left[near] = 0
    return place, light, total
