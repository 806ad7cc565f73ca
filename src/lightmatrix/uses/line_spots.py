"""The brightest spot of each row of T beside its epipolar line: where direct light comes from."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.transport.sparse_rows import row_blocks
from lightmatrix.uses.spots import ENTRIES, entries_of

# The middle of a spot lies within this distance of the epipolar line, in projector pixels. Chosen
# by hand: one pixel and a half leave room for a spot that lies between pixels.
_BAND = 1.5
# How far the 3 x 3 pixels around a middle reach from it.
_REACH = 1.5
# Times that the window is centred on the light within it; it then moves by less than 0.01 pixels.
_RECENTRED = 4
# A line tells where it crosses the border if the sine between them is this or more. Chosen by
# hand: errors of the coordinate then grow threefold at most.
_STEEP = 0.3
# Half width of the window of a sharp spot, and what it grows by with the standard deviation of a
# spot that is out of focus, in projector pixels: 1.5 for one pixel, 2.5 under a blur of 1 pixel.
# Chosen by hand.
_LEAST_HALF_WIDTH, _HALF_WIDTH_PER_DEVIATION = 1.5, 2.4
# Blocks of rows that are searched at the same time. Each takes about 400 MiB.
_THREADS = 2


@dataclass(frozen=True, eq=False)
class LineSpots:
    """One spot for each of P camera pixels.

    Parameters
    ----------
    place : (P, 2) float64
        Its centre as row and column of the projector; NaN where there is no light by the line.
    light : (P,) float64
        The light within its window.
    total : (P,) float64
        The light of the whole row, background included.
    """

    place: NDArray[np.float64]
    light: NDArray[np.float64]
    total: NDArray[np.float64]


def window_half_width(deviation: float) -> float:
    """Half width of the window around spots of this standard deviation, in projector pixels."""
    return max(_LEAST_HALF_WIDTH, _HALF_WIDTH_PER_DEVIATION * deviation)


def find_line_spots(
    matrix: csr_array,
    background: NDArray[np.float64],
    lines: NDArray[np.float64],
    pixels: NDArray[np.float64],
    shape: tuple[int, int],
    half_width: float,
) -> LineSpots:
    """Find the spot of each row of T, (P, N), beside its line.

    Of all 3 x 3 pixels whose middle lies within 1.5 pixels of the line, the brightest are the spot.
    Its place is the centroid of the light in a window around it, whose borders cut pixels in parts,
    so that it moves smoothly.

    `lines` (P, 3) are a, b, c with a^2 + b^2 = 1 and a col + b row + c = 0, `pixels` (N, 2) the
    column and row of each projector pixel without distortion.
    """
    count = int(matrix.shape[0])
    place = np.full((count, 2), np.nan)
    light, total = np.zeros(count), np.zeros(count)
    if not matrix.has_sorted_indices:
        matrix = matrix.copy()
        matrix.sort_indices()

    def find(start: int, stop: int) -> None:
        rows = slice(start, stop)
        part = csr_array(matrix[rows])
        place[rows], light[rows], total[rows] = _of_block(
            part, lines[rows], pixels, shape, half_width
        )

    cuts = row_blocks(matrix.indptr, ENTRIES).tolist()
    with ThreadPoolExecutor(_THREADS) as threads:
        # `list` raises what a thread raised.
        list(threads.map(find, cuts[:-1], cuts[1:]))
    return LineSpots(place, light, total + np.maximum(background, 0))


def uncut_places(
    place: NDArray[np.float64],
    lines: NDArray[np.float64],
    shape: tuple[int, int],
    margin: float,
) -> NDArray[np.float64]:
    """Places of spots, corrected where the projector's border cuts a spot off.

    Within `margin` of the outermost pixels, the coordinate across the border is where the line
    crosses the other coordinate, which nothing cuts. It moves outwards only, and by a pixel at
    most; distortion hardly matters over so short a way.
    """
    result = place.copy()
    for axis in (0, 1):
        along, across = lines[:, 1 - axis], lines[:, axis]
        low, high = place[:, axis] < margin, place[:, axis] > shape[axis] - 1 - margin
        # Columns of `lines` belong to (col, row), those of `place` to (row, col).
        with np.errstate(invalid="ignore", divide="ignore"):
            crossing = -(across * place[:, 1 - axis] + lines[:, 2]) / along
        steep = np.abs(along) >= _STEEP
        outwards = np.where(low, place[:, axis] - crossing, crossing - place[:, axis])
        cut = (low | high) & steep & (outwards > 0) & (outwards <= 1)
        result[cut, axis] = crossing[cut]
    return result


def _of_block(
    matrix: csr_array,
    lines: NDArray[np.float64],
    pixels: NDArray[np.float64],
    shape: tuple[int, int],
    half_width: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Places, light and total light of the spots of some rows."""
    count = int(matrix.shape[0])
    owner, row, col = entries_of(matrix, shape[1])
    # Some estimates allow negative light, which does not count.
    light = np.maximum(matrix.data, 0).astype(np.float64)
    total = np.bincount(owner, light, count).astype(np.float64)
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    ideal_col, ideal_row = np.ascontiguousarray(pixels.T).take(matrix.indices, axis=1)
    across, down, shift = np.ascontiguousarray(lines.T)
    distance = np.abs(across[owner] * ideal_col + down[owner] * ideal_row + shift[owner])
    near = np.flatnonzero(distance <= _BAND + _REACH + half_width)
    owner, light, distance = owner[near], light[near], distance[near]
    row, col = row[near], col[near]
    middle_row, middle_col = _brightest(owner, row, col, light, distance <= _BAND, shape, count)
    # The window moves by up to a pixel.
    reach = half_width + _REACH
    inside = np.abs(row - middle_row[owner]) <= reach
    inside &= np.abs(col - middle_col[owner]) <= reach
    owner, row, col, light = owner[inside], row[inside], col[inside], light[inside]
    held = np.zeros(count)
    for _ in range(_RECENTRED):
        share = np.clip(half_width + 0.5 - np.abs(row - middle_row[owner]), 0, 1)
        share *= np.clip(half_width + 0.5 - np.abs(col - middle_col[owner]), 0, 1)
        share *= light
        held = np.bincount(owner, share, count).astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            middle_row = np.bincount(owner, share * row, count) / held
            middle_col = np.bincount(owner, share * col, count) / held
    return np.stack([middle_row, middle_col], axis=1), held, total


def _brightest(
    owner: NDArray[np.int64],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    light: NDArray[np.float64],
    possible: NDArray[np.bool_],
    shape: tuple[int, int],
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Row and column of the brightest 3 x 3 pixels of each row of T; NaN where there is none.

    Only entries that are `possible` are middles. Entries are sorted by row and pixel.
    """
    # Numbers of the pixels of all rows, with a border, so that no neighbour lies across an edge.
    width = shape[1] + 2
    place = (row.astype(np.int64) + 1) * width + col.astype(np.int64) + 1
    number = owner * ((shape[0] + 2) * width) + place
    padded = np.append(number, [np.iinfo(np.int64).max] * 3)
    padded_light = np.append(light, [0.0] * 3)
    sums = np.zeros(len(number))
    for down in (-1, 0, 1):
        first = number + down * width - 1
        found = np.searchsorted(number, first)
        for step in range(3):
            sums += np.where(padded[found + step] <= first + 2, padded_light[found + step], 0)
    sums[~possible | (light <= 0)] = 0
    best = np.zeros(count)
    if len(owner):
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        best[owner[starts]] = np.maximum.reduceat(sums, starts)
    strongest = np.flatnonzero((sums == best[owner]) & (sums > 0))[::-1]
    middle_row, middle_col = np.full((2, count), np.nan)
    # In reverse order, so that the first of several equal ones stays.
    middle_row[owner[strongest]] = row[strongest]
    middle_col[owner[strongest]] = col[strongest]
    return middle_row, middle_col
