"""The Jacobian of the correspondence: how footprints move from camera pixel to camera pixel.

It is measured, and not derived from the sizes of camera and projector. At first the strongest
pixels of many rows are wrong, but they are wrong at random: among the displacements between
neighbouring camera pixels the true one stands out as a peak, whatever the scale, the angle or the
part that projector and camera see of each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.camera_grid import mean_around


@dataclass(frozen=True)
class JacobianConstants:
    """How the Jacobian is measured; all values are chosen by hand.

    Together they find it to a fiftieth of a pixel (`tests/estimators/test_correspondence.py`).
    """

    # The longest displacement between neighbours that is counted, in projector pixels.
    fastest: int = 12
    # The largest distance in camera pixels over which displacements are counted for the whole
    # frame. It starts at 1 and doubles: the longer, the finer the mean Jacobian.
    farthest: int = 16
    # A displacement in projector pixels that is long enough; the distance grows no further.
    long: int = 8
    # The peak at a distance lies this close to the one predicted from half the distance, in
    # projector pixels per camera pixel.
    nearby: float = 0.75
    # Camera pixels to both sides between which the local Jacobian is measured.
    step: int = 2
    # Side of the square of camera pixels whose median is the local Jacobian.
    window: int = 9
    # A local displacement is an outlier if it differs from that of the whole frame by more than
    # this many times its length: a row is wrong, or a depth edge lies between.
    unlike: float = 2.0
    # Medians of displacements of whole pixels are coarse. The final value is the mean, over a
    # square of this side, of the displacements within the distance `alike` of the median.
    finer_window: int = 15
    alike: float = 0.5


JACOBIAN = JacobianConstants()


def measure_jacobian(
    rows: csr_array, camera: tuple[int, int, int], projector: tuple[int, int], spacing: int = 1
) -> NDArray[np.float32]:
    """How footprints move per camera row and column, (M, 4), in projector rows and columns.

    `rows` are coefficients of atoms, S planes of N pixels, (M, S N), `spacing` camera pixels apart.
    The result is rows by rows, rows by columns, columns by rows, columns by columns.
    """
    pixel = strongest_entries(rows) % (projector[0] * projector[1])
    places = [place.reshape(camera) for place in np.divmod(pixel, projector[1])]
    lit = (np.diff(rows.indptr) > 0).reshape(camera)
    result = np.empty((*camera, 4), np.float32)
    for axis in (0, 1):
        usual = _frame_displacement(places, lit, axis, JACOBIAN.fastest * spacing)
        slopes = [_slope(place, axis) for place in places]
        off = np.hypot(slopes[0] - usual[0], slopes[1] - usual[1])
        outliers = (off > JACOBIAN.unlike * max(1.0, float(np.hypot(*usual)))) | ~lit
        for i in (0, 1):
            slope = np.where(outliers, np.float32(usual[i]), slopes[i])
            size = (JACOBIAN.window, JACOBIAN.window, 1)
            median = median_filter(slope, size=size, mode="nearest")
            alike = np.abs(slope - median) <= JACOBIAN.alike
            finer = mean_around(slope, alike, JACOBIAN.finer_window)
            result[..., 2 * i + axis] = np.where(np.isnan(finer), median, finer)
    return result.reshape(-1, 4)


def strongest_entries(rows: csr_array) -> NDArray[np.int64]:
    """The column of the strongest entry of each row, (M,); the last of equal ones, 0 if empty."""
    entries = np.diff(rows.indptr)
    result = np.zeros(len(entries), np.int64)
    lit = np.flatnonzero(entries)
    if len(lit):
        most = np.maximum.reduceat(rows.data, rows.indptr[lit])
        strong = np.flatnonzero(rows.data == np.repeat(most, entries[lit]))
        # NumPy writes equal ones in order, so that the last one stays.
        result[np.repeat(np.arange(len(entries)), entries)[strong]] = rows.indices[strong]
    return result


def _frame_displacement(
    places: list[NDArray[np.int64]], lit: NDArray[np.bool_], axis: int, fastest: int
) -> tuple[float, float]:
    """The commonest displacement per camera pixel along an axis; (0, 0) where there is none."""
    length = lit.shape[axis]
    mean = (0.0, 0.0)
    distance = 1
    while distance <= min(JACOBIAN.farthest, length - 1):
        here, there = np.arange(length - distance), np.arange(distance, length)
        both = lit.take(here, axis) & lit.take(there, axis)
        steps = [(place.take(there, axis) - place.take(here, axis))[both] for place in places]
        predicted = [round(part * distance) for part in mean]
        reach = fastest if distance == 1 else max(3, int(np.ceil(JACOBIAN.nearby * distance)))
        peak = _commonest([s - p for s, p in zip(steps, predicted, strict=True)], reach)
        if peak is None:
            break
        sizes = [p + offset for p, offset in zip(predicted, peak, strict=True)]
        mean = (sizes[0] / distance, sizes[1] / distance)
        if max(map(abs, sizes)) >= JACOBIAN.long:
            break
        distance *= 2
    return mean


def _commonest(steps: list[NDArray[np.int64]], reach: int) -> tuple[float, float] | None:
    """The centre of the commonest 3 x 3 displacements, none longer than `reach`; None if none."""
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
    """Differences along an axis per pixel, between `step` pixels to both sides."""
    length = place.shape[axis]
    index = np.arange(length)
    before = np.maximum(index - JACOBIAN.step, 0)
    after = np.minimum(index + JACOBIAN.step, length - 1)
    distance = np.maximum(after - before, 1).reshape(-1, *[1] * (place.ndim - 1 - axis))
    return ((place.take(after, axis) - place.take(before, axis)) / distance).astype(np.float32)
