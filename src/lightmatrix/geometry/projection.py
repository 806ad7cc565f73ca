"""Projection matrices: their scale, and the lens, rotation and place that they consist of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import rq

from lightmatrix.errors import InputError

# Checks of the numbers that a geometry is made of.


Shape = tuple[int, int]


def points_of(points: ArrayLike, size: int) -> NDArray[np.float64]:
    """Points as (n, size) float64."""
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != size:
        names = "(col, row)" if size == 2 else "(X, Y, Z)"
        raise InputError(
            f"points of shape {array.shape}", hint=f"give an array (n, {size}) of {names}"
        )
    return array


def numbers(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """An array of finite float64 of a shape."""
    size = " x ".join(map(str, shape))
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {what} holds no numbers", hint=f"give {size} numbers") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(
            f"the {what} has shape {array.shape}, or is not finite",
            hint=f"give {size} finite numbers",
        )
    return array


def distortion(values: ArrayLike, device: str) -> NDArray[np.float64]:
    """Five coefficients; OpenCV leaves out those at the end that are 0."""
    given = np.ravel(np.asarray(values))
    if len(given) > 5 and not np.any(given[5:]):
        given = given[:5]
    if len(given) > 5:
        raise InputError(
            f"the {device}'s distortion has {len(given)} coefficients",
            hint="calibrate with OpenCV's model of five: k1, k2, p1, p2, k3",
        )
    return numbers(np.append(given, np.zeros(5 - len(given))), (5,), f"{device}'s distortion")


def image_shape(shape: Any, device: str) -> Shape:
    """Rows and columns as whole numbers of at least 1."""
    try:
        rows, cols = (int(size) for size in shape)
        whole = (rows, cols) == tuple(shape)
    except (TypeError, ValueError, OverflowError):
        rows = cols = 0
        whole = False
    if not whole or min(rows, cols) < 1:
        raise InputError(
            f"an image size of {shape} of the {device}", hint="give (rows, cols) in pixels"
        )
    return rows, cols


# Lens distortion, after Brown (1971), with OpenCV's five coefficients.
#
# A point at (x, y) on the plane of distance 1 in front of an ideal lens, r^2 = x^2 + y^2, is seen
# at
#
# x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
# y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y


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


# The least ratio of the smallest to the largest singular value of the left 3 x 3 part, its columns
# in pixels. A matrix below it belongs to a device at an infinite distance, which has no depth.
_LEAST_RATIO = 1e-12


def normalised(matrix: ArrayLike, device: str) -> NDArray[np.float64]:
    """A projection matrix (3, 4) scaled so that its third row gives the distance along the axis."""
    try:
        whole = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"the {device}'s projection matrix holds no numbers", hint="give 3 x 4 numbers"
        ) from error
    if whole.shape != (3, 4) or not np.isfinite(whole).all():
        size = " x ".join(map(str, whole.shape)) or "a single number"
        raise InputError(
            f"the {device}'s projection matrix is {size}, or not finite",
            hint="give 3 x 4 finite numbers that lead from (X, Y, Z, 1) to (col, row, 1)",
        )
    values = np.linalg.svd(whole[:, :3], compute_uv=False)
    if not values[-1] > _LEAST_RATIO * values[0]:
        raise InputError(
            f"the {device}'s projection matrix has no centre: its left 3 x 3 part is singular",
            hint="give the matrix of a perspective camera, K [R | t]",
        )
    # The determinant of K R is positive, so its sign tells front from back.
    return whole * (np.sign(np.linalg.det(whole[:, :3])) / np.linalg.norm(whole[2, :3]))


def decomposed(
    matrix: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """K (3, 3), R (3, 3) and t (3,) of a normalised projection matrix K [R | t]."""
    intrinsics, rotation = rq(matrix[:, :3])
    signs = np.where(np.diag(intrinsics) < 0, -1.0, 1.0)
    intrinsics, rotation = intrinsics * signs, rotation * signs[:, None]
    translation = np.linalg.solve(intrinsics, matrix[:, 3])
    return intrinsics / intrinsics[2, 2], rotation, translation * intrinsics[2, 2]


def centre_of(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centre (3,) of a device: the point that it projects nowhere."""
    return np.asarray(np.linalg.solve(matrix[:, :3], -matrix[:, 3]))


def binned_matrix(
    matrix: NDArray[np.float64], block: tuple[float, float], corner: Shape = (0, 0)
) -> NDArray[np.float64]:
    """The matrix (3, ...) for pixels cut from a corner (row, col), then binned by a block.

    The centre of the first block of b pixels lies at (b - 1) / 2, so that pixel centres stay at
    whole numbers. A block of 1 / n divides each pixel into n.
    """
    (down, across), (row, col) = block, corner
    change = np.array(
        [
            [1 / across, 0, ((1 - across) / 2 - col) / across],
            [0, 1 / down, ((1 - down) / 2 - row) / down],
            [0, 0, 1],
        ]
    )
    return change @ matrix


def binned(
    matrix: NDArray[np.float64], shape: Shape, factor: int | Shape, device: str
) -> tuple[NDArray[np.float64], Shape]:
    """Matrix and image size of a device whose pixels are binned by blocks of (rows, cols)."""
    block = (factor, factor) if isinstance(factor, int) else factor
    small = (shape[0] // max(block[0], 1), shape[1] // max(block[1], 1))
    if min(block) < 1 or min(small) < 1:
        raise InputError(
            f"{device} blocks of {block[0]} x {block[1]} pixels of {shape[0]} x {shape[1]}",
            hint="use blocks of at least 1 pixel that fit into the image",
        )
    return binned_matrix(matrix, block), small


def projected(matrix: NDArray[np.float64], points: ArrayLike) -> NDArray[np.float64]:
    """Undistorted pixels (n, 2) as (col, row) of points (n, 3); NaN behind the device."""
    image = points_of(points, 3) @ matrix[:, :3].T + matrix[:, 3]
    with np.errstate(all="ignore"):
        return np.where(image[:, 2:] > 0, image[:, :2] / image[:, 2:], np.nan)


def points_on_rays(
    centre: NDArray[np.float64],
    rays: NDArray[np.float64],
    matrix: NDArray[np.float64],
    pixels: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The point (n, 3) of each ray (n, 3) from `centre` that is seen nearest to a pixel (n, 2).

    The matrix belongs to the device of the pixels, which are undistorted.
    """
    # The image of the ray is a + s b for the depth s.
    a = matrix @ np.append(centre, 1)
    b = rays @ matrix[:, :3].T
    line = np.cross(a, b)
    with np.errstate(all="ignore"):
        away = (pixels * line[:, :2]).sum(axis=1) + line[:, 2]
        foot = pixels - (away / (line[:, :2] ** 2).sum(axis=1))[:, None] * line[:, :2]
        # (a + s b) is a multiple of (foot, 1): two equations for s, both exact.
        left = b[:, :2] - foot * b[:, 2:]
        right = foot * a[2] - a[:2]
        depth = (left * right).sum(axis=1) / (left**2).sum(axis=1)
        return np.asarray(centre + depth[:, None] * rays)
