"""Normals and triangles of a surface of which the depth of each camera pixel is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lightmatrix.geometry.rig_geometry import RigGeometry

# Neighbouring pixels lie on one surface if it need not be inclined by more than this to the image
# plane, in degrees. Chosen by hand: steeper surfaces reflect little of the projector's light.
_STEEPEST = 70.0
# Pixels to both sides whose points a normal is fitted to, and the fewest of them.
_REACH, _FEWEST = 2, 6
# Side of the square of pixels over which errors are averaged.
_AVERAGED = 5


def local_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the finite values within 5 x 5 pixels, (rows, cols); NaN where there are none."""
    known = np.isfinite(values)
    shares = uniform_filter(known.astype(np.float64), _AVERAGED, mode="constant")
    sums = uniform_filter(np.where(known, values, 0.0), _AVERAGED, mode="constant")
    # Running sums leave rounding errors where nothing is known.
    least = 0.5 / _AVERAGED**2
    return np.where(shares > least, np.maximum(sums, 0) / np.maximum(shares, least), np.nan)


def steepest_step(depth: NDArray[np.floating], geometry: RigGeometry) -> NDArray[np.float64]:
    """The largest change of depth from a pixel to the next on one surface, (rows, cols)."""
    focal = float(np.sqrt(np.prod(np.diag(geometry.camera_intrinsics)[:2])))
    return np.asarray(depth / focal * np.tan(np.radians(_STEEPEST)), np.float64)


def surface_normals(
    points: NDArray[np.float32], depth: NDArray[np.float32], geometry: RigGeometry
) -> NDArray[np.float32]:
    """Unit normals (rows, cols, 3) that face the camera, by planes through 5 x 5 points.

    The plane n . x = 1, relative to the camera, is the least-squares solution over the neighbours
    on the same surface; its right-hand side weighs all of them alike.
    """
    rows, cols = depth.shape
    centre = geometry.camera_centre
    # Relative to the camera, and of size about 1, so that the normal equations stay well scaled.
    scale = float(np.nanmedian(depth)) if np.isfinite(depth).any() else 1.0
    local = (points - centre) / scale
    limit = steepest_step(depth, geometry)
    known = np.nan_to_num(local.astype(np.float64))
    # The products of two coordinates, the coordinates, and 1: what the normal equations sum up.
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    terms = [known[..., i] * known[..., j] for i, j in pairs]
    terms += [*np.moveaxis(known, -1, 0), np.ones((rows, cols))]
    sums = np.zeros((len(terms), rows, cols))
    for down in range(-_REACH, _REACH + 1):
        for right in range(-_REACH, _REACH + 1):
            here = _shifted(rows, -down), _shifted(cols, -right)
            there = _shifted(rows, down), _shifted(cols, right)
            steps = max(abs(down), abs(right))
            near = np.abs(depth[there] - depth[here]) <= steps * limit[here]
            for total, term in zip(sums, terms, strict=True):
                total[here] += term[there] * near
    counts = sums[-1]
    good = counts >= _FEWEST
    normals = np.full((rows, cols, 3), np.nan)
    if good.any():
        # A trace of the unit matrix keeps points on a line from being singular.
        matrix = np.empty((int(good.sum()), 3, 3))
        for total, (i, j) in zip(sums, pairs, strict=False):
            matrix[:, i, j] = matrix[:, j, i] = total[good]
        right_side = sums[len(pairs) : -1][:, good].T[..., None]
        plane = np.linalg.solve(matrix + 1e-12 * np.eye(3), right_side)[..., 0]
        # The plane through the points does not pass through the camera, which lies at n . x = 0.
        normals[good] = -plane / np.linalg.norm(plane, axis=1, keepdims=True)
    return normals.astype(np.float32)


def surface_faces(depth: NDArray[np.float32], geometry: RigGeometry) -> NDArray[np.int64]:
    """Triangles (n, 3) of pixel numbers, two for each square of four pixels on one surface.

    They are counter-clockwise as the camera sees them.
    """
    number = np.arange(depth.size).reshape(depth.shape)
    limit = steepest_step(depth, geometry)
    corners = (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:])
    faces = []
    for one, two, three in ((0, 1, 2), (0, 2, 3)):
        chosen = [corners[k] for k in (one, two, three)]
        depths = np.stack([depth[corner] for corner in chosen])
        # Comparisons with NaN are False.
        flat = np.ptp(depths, axis=0) <= 1.5 * limit[chosen[0]]
        faces.append(np.stack([number[corner][flat] for corner in chosen], axis=1))
    return np.concatenate(faces)


def _shifted(size: int, by: int) -> slice:
    """The part of an axis that still lies inside once it is moved back by so many pixels."""
    return slice(max(0, by), size - max(0, -by))
