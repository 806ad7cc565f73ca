"""Projection matrices: their scale, and the lens, rotation and place that they consist of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import rq

from lightmatrix.errors import InputError
from lightmatrix.geometry.checks import Shape, points_of

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
