"""Lens distortion, after Brown (1971), with OpenCV's five coefficients.

A point at (x, y) on the plane of distance 1 in front of an ideal lens, r^2 = x^2 + y^2, is seen at

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lightmatrix.geometry.checks import points_of

Array = NDArray[np.float64]

# Newton's steps of `undistort`. Each doubles the correct digits, so that strong distortions
# converge in about six.
_STEPS = 12
# They end when no point moves further than this, which the next step would not change.
_STEP = 1e-9
# A point is undistorted if the lens leads back to within this distance, on the plane of distance 1:
# a thousandth of a pixel at a focal length of 10,000 pixels.
_TOLERANCE = 1e-7


def distort(points: NDArray[np.float64], lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points (n, 2) as (x, y) on the plane of distance 1 are seen through the lens (5,)."""
    if not lens.any():
        return points
    return _seen(points, lens)[0]


def undistort(points: NDArray[np.float64], lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 2) that the lens (5,) shows at `points`, by Newton's method.

    NaN where there is none, as beyond the field of view of a barrel distortion.
    """
    if not lens.any():
        return points
    ideal = points.copy()
    # Overflow and singular steps end as NaN.
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            seen, (xx, xy, yx, yy) = _seen(ideal, lens)
            dx, dy = (points - seen).T
            determinant = xx * yy - xy * yx
            step = np.column_stack([yy * dx - xy * dy, xx * dy - yx * dx]) / determinant[:, None]
            ideal = ideal + step
            if not (np.abs(step) > _STEP).any():
                break
        error, (xx, xy, yx, yy) = _seen(ideal, lens)
        # Where the determinant is negative, the lens has folded the image over.
        good = np.abs(error - points).max(axis=1) < _TOLERANCE
        good &= (xx * yy - xy * yx > 0) & (xx + yy > 0)
    return np.where(good[:, None], ideal, np.nan)


def through_lens(
    bend: Callable[[Array, Array], Array],
    points: ArrayLike,
    intrinsics: NDArray[np.float64],
    lens: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Pixels (n, 2) after a lens function that works on the plane of distance 1."""
    pixels = points_of(points, 2)
    if not lens.any():
        return pixels
    inverse = np.linalg.inv(intrinsics)
    plane = bend(pixels @ inverse[:2, :2].T + inverse[:2, 2], lens)
    return np.asarray(plane @ intrinsics[:2, :2].T + intrinsics[:2, 2])


def _seen(
    points: NDArray[np.float64], lens: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], ...]]:
    """Distorted points and the four derivatives dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3 = lens
    x, y = points.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    # Derivative of `radial` by the square of the radius.
    slope = k1 + square * (2 * k2 + square * 3 * k3)
    seen = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return seen, (xx, mixed, mixed, yy)
