"""The surface that each camera pixel of a scene sees: exact depth and normals, without a renderer.

Every pixel's ray meets the planes of the triangles whose images cover the pixel, and the nearest
one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightmatrix.geometry.projection import binned_matrix
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.simulation.geometry import Mesh, merge
from lightmatrix.simulation.scenes.scene import Scene

# Pairs of a triangle and a pixel that are tested at a time: about 300 MB of temporary arrays.
_PAIRS = 1 << 21
# Rays through an edge belong to both triangles: they may miss each by this share of its area.
_EDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Surface:
    """What camera pixels see.

    Parameters
    ----------
    depth : (rows, cols) float64
        Distance along the camera's axis at the centre of each pixel; NaN where it sees nothing.
    normals : (rows, cols, 3) float64
        Unit normals in the world's frame that face the camera; NaN where it sees nothing.
    """

    depth: NDArray[np.float64]
    normals: NDArray[np.float64]


def view_geometry(
    scene: Scene, camera_shape: tuple[int, ...], projector_shape: tuple[int, int]
) -> RigGeometry:
    """The geometry of a scene's camera and projector for images of these sizes."""
    rows, cols = camera_shape[:2]
    return RigGeometry.from_matrices(
        scene.camera.matrix((rows, cols)),
        scene.projector.matrix(projector_shape),
        (rows, cols),
        projector_shape,
        units="scene unit",
    )


def finer(geometry: RigGeometry, side: int) -> RigGeometry:
    """The geometry of a camera with `side` x `side` pixels in place of each."""
    rows, cols = geometry.camera_shape
    return replace(
        geometry,
        camera_matrix=binned_matrix(geometry.camera_matrix, (1 / side, 1 / side)),
        camera_shape=(rows * side, cols * side),
    )


def trace_surface(scene: Scene, geometry: RigGeometry) -> Surface:
    """Depth and normals of a scene as a camera without distortion sees it."""
    mesh = merge([part.mesh for part in scene.parts])
    corners = mesh.vertices[mesh.faces]
    # Triangles behind the camera do not occur, since scenes lie in front of it.
    depth, nearest = _nearest(mesh, geometry)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(invalid="ignore"):
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = ((corners[:, 0] - geometry.camera_centre) * normals).sum(axis=1) > 0
    normals[away] *= -1
    seen = np.where((nearest >= 0)[:, None], normals[nearest], np.nan)
    return Surface(depth.reshape(geometry.camera_shape), seen.reshape(*geometry.camera_shape, 3))


def _nearest(mesh: Mesh, geometry: RigGeometry) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Depth (pixels,) of the nearest triangle at each pixel centre and its number, -1 for none."""
    matrix = geometry.camera_matrix
    rows, cols = geometry.camera_shape
    # In homogeneous pixels, the third number of a point is its depth.
    points = (mesh.vertices @ matrix[:, :3].T + matrix[:, 3])[mesh.faces]
    image = points[..., :2] / points[..., 2:]
    first = np.ceil(image.min(axis=1) - _EDGE).astype(np.int64).clip(0)
    last = np.floor(image.max(axis=1) + _EDGE).astype(np.int64)
    last = np.minimum(last, [cols - 1, rows - 1])
    sizes = (last - first + 1).clip(0)
    counts = sizes.prod(axis=1)
    depth = np.full(rows * cols, np.inf)
    nearest = np.full(rows * cols, -1, np.int64)
    for start, stop in _batches(counts):
        triangle = np.repeat(np.arange(start, stop), counts[start:stop])
        within = np.arange(len(triangle)) - np.repeat(
            np.cumsum(counts[start:stop]) - counts[start:stop], counts[start:stop]
        )
        row, col = np.divmod(within, sizes[triangle, 0])
        col, row = first[triangle, 0] + col, first[triangle, 1] + row
        hit, distance = _hits(points[triangle], np.column_stack([col, row]))
        pixel, distance, triangle = (row * cols + col)[hit], distance[hit], triangle[hit]
        # The nearest of each pixel comes last, and is the one that an assignment keeps.
        order = np.lexsort((-distance, pixel))
        pixel, distance, triangle = pixel[order], distance[order], triangle[order]
        final = np.append(pixel[1:] != pixel[:-1], True)[: len(pixel)]
        pixel, distance, triangle = pixel[final], distance[final], triangle[final]
        closer = distance < depth[pixel]
        depth[pixel[closer]] = distance[closer]
        nearest[pixel[closer]] = triangle[closer]
    return np.where(nearest >= 0, depth, np.nan), nearest


def _batches(counts: NDArray[np.int64]) -> Sequence[tuple[int, int]]:
    """Ranges of triangles with about `_PAIRS` pixels each; one triangle may have more."""
    batch = np.cumsum(counts) // _PAIRS
    cuts = [0, *(np.flatnonzero(np.diff(batch)) + 1), len(counts)]
    return [(int(a), int(b)) for a, b in pairwise(cuts) if b > a]


def _hits(
    points: NDArray[np.float64], pixels: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether rays of pixels (n, 2) meet triangles (n, 3, 3) in homogeneous pixels, and the depth.

    With a ray r = (col, row, 1), corners a, b, c and their determinant [a b c], the ray meets the
    plane at the depth [a b c] / ([r b c] + [a r c] + [a b r]), inside if all terms have one sign.
    """
    a, b, c = points[:, 0], points[:, 1], points[:, 2]
    ray = np.column_stack([pixels, np.ones(len(pixels))])
    terms = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    parts = np.einsum("ntk,nk->nt", terms, ray)
    total = parts.sum(axis=1)
    volume = (a * terms[:, 0]).sum(axis=1)
    parts *= np.sign(total)[:, None]
    with np.errstate(all="ignore"):
        depth = volume / total
        inside = (parts >= -_EDGE * np.abs(total)[:, None]).all(axis=1)
    return inside & (total != 0) & (depth > 0), depth
