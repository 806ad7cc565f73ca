"""How footprints move from camera pixel to camera pixel: measured, never told from sizes.

The strongest pixels of many rows are wrong at first, but they are wrong at random: among the
displacements between neighbouring camera pixels the true one stands out as a peak, whatever the
scale, the angle or the part that projector and camera see of each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.pooling import mean_around

# Displacements are counted up to so many projector pixels a camera pixel,
FASTEST = 12
# first between neighbours, then over twice the distance, and again, up to so many camera pixels or
# until they are so many projector pixels long: the longer, the finer the movement is known.
FARTHEST, LONG = 16, 8
# The peak of the next distance lies within this share of it.
NEARBY = 0.75
# Locally, movement is measured between rows that lie this far to both sides, as the median over a
# window of so many camera pixels;
STEP = 2
WINDOW = 9
# where it differs from that of the whole frame by more than so many times as much, it is a wrong
# row's or leads across a depth edge.
UNLIKE = 2.0
# Medians of steps of whole pixels are coarse. Finer is the mean, over so many camera pixels, of
# what differs from the median by no more than this.
FINER_WINDOW, ALIKE = 15, 0.5


def measured_movement(
    rows: csr_array, camera: tuple[int, int, int], projector: tuple[int, int], spacing: int = 1
) -> NDArray[np.float32]:
    """Projector rows and columns that footprints move a camera row and a camera column on.

    Parameters
    ----------
    rows : (M, S N) csr_array
        Coefficients of atoms: S planes of N projector pixels.
    camera : (int, int, int)
        Rows, columns and channels of the camera, M in all.
    projector : (int, int)
        Rows and columns of the projector, N in all.
    spacing : int
        Of the rows, in camera pixels: they may move so many times as far.

    Returns
    -------
    (M, 4) float32
        Rows by rows, rows by columns, columns by rows, columns by columns.
    """
    pixel = strongest(rows) % (projector[0] * projector[1])
    places = [place.reshape(camera) for place in np.divmod(pixel, projector[1])]
    lit = (np.diff(rows.indptr) > 0).reshape(camera)
    result = np.empty((*camera, 4), np.float32)
    for axis in (0, 1):
        usual = _peak(places, lit, axis, FASTEST * spacing)
        slopes = [_slope(place, axis) for place in places]
        off = np.hypot(slopes[0] - usual[0], slopes[1] - usual[1])
        odd = (off > UNLIKE * max(1.0, float(np.hypot(*usual)))) | ~lit
        for i in (0, 1):
            slope = np.where(odd, np.float32(usual[i]), slopes[i])
            median = median_filter(slope, size=(WINDOW, WINDOW, 1), mode="nearest")
            alike = np.abs(slope - median) <= ALIKE
            finer = mean_around(slope, alike, FINER_WINDOW)
            result[..., 2 * i + axis] = np.where(np.isnan(finer), median, finer)
    return result.reshape(-1, 4)


def strongest(rows: csr_array) -> NDArray[np.int64]:
    """The strongest entry of each row, (M,); 0 in empty rows."""
    entries = np.diff(rows.indptr)
    result = np.zeros(len(entries), np.int64)
    lit = np.flatnonzero(entries)
    if len(lit):
        most = np.maximum.reduceat(rows.data, rows.indptr[lit])
        strong = np.flatnonzero(rows.data == np.repeat(most, entries[lit]))
        # Of equals the last: it is written last.
        result[np.repeat(np.arange(len(entries)), entries)[strong]] = rows.indices[strong]
    return result


def _peak(
    places: list[NDArray[np.int64]], lit: NDArray[np.bool_], axis: int, fastest: int
) -> tuple[float, float]:
    """The commonest movement along an axis of the camera; (0, 0) where there is none."""
    length = lit.shape[axis]
    movement = (0.0, 0.0)
    distance = 1
    while distance <= min(FARTHEST, length - 1):
        here, there = np.arange(length - distance), np.arange(distance, length)
        both = lit.take(here, axis) & lit.take(there, axis)
        steps = [(place.take(there, axis) - place.take(here, axis))[both] for place in places]
        middle = [round(m * distance) for m in movement]
        reach = fastest if distance == 1 else max(3, int(np.ceil(NEARBY * distance)))
        found = _commonest([s - m for s, m in zip(steps, middle, strict=True)], reach)
        if found is None:
            break
        sizes = [m + f for m, f in zip(middle, found, strict=True)]
        movement = (sizes[0] / distance, sizes[1] / distance)
        if max(map(abs, sizes)) >= LONG:
            break
        distance *= 2
    return movement


def _commonest(steps: list[NDArray[np.int64]], reach: int) -> tuple[float, float] | None:
    """Centre of the 3 x 3 displacements that most have, none longer than `reach`."""
    side = 2 * reach + 1
    near = (np.abs(steps[0]) <= reach) & (np.abs(steps[1]) <= reach)
    if not near.any():
        return None
    flat = (steps[0][near] + reach) * side + steps[1][near] + reach
    counts = np.bincount(flat, minlength=side * side).reshape(side, side).astype(np.float64)
    sums = uniform_filter(counts, 3, mode="constant")
    r, c = np.unravel_index(int(sums.argmax()), sums.shape)
    around = np.pad(counts, 1)[r : r + 3, c : c + 3]
    down, right = np.mgrid[-1:2, -1:2]
    total = around.sum()
    return (
        float((around * down).sum() / total) + int(r) - reach,
        float((around * right).sum() / total) + int(c) - reach,
    )


def _slope(place: NDArray[np.int64], axis: int) -> NDArray[np.float32]:
    """Differences along an axis to both sides, over the distance; 0 on a single pixel."""
    length = place.shape[axis]
    index = np.arange(length)
    before = np.maximum(index - STEP, 0)
    after = np.minimum(index + STEP, length - 1)
    distance = np.maximum(after - before, 1).reshape(-1, *[1] * (place.ndim - 1 - axis))
    return ((place.take(after, axis) - place.take(before, axis)) / distance).astype(np.float32)
