"""Meshes of the scenes, lofted through rings of points so that edges can be bevelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64 in scene units, faces (F, 3) int."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    def placed(
        self, position: ArrayLike = (0, 0, 0), rotation: NDArray[np.float64] | None = None
    ) -> Mesh:
        """The mesh rotated about its origin, then moved."""
        turned = self.vertices if rotation is None else self.vertices @ rotation.T
        return Mesh(turned + np.asarray(position, float), self.faces)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Join several meshes."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + off for mesh, off in zip(meshes, offsets, strict=True)]),
    )


def loft(rings: Sequence[NDArray[np.float64]], centre: tuple[float, float] | None) -> Mesh:
    """A surface through closed rings (n, 3), counter-clockwise from above, bottom to top.

    The first and last ring are closed by fans around `centre`, which must see all of them; None
    joins the last ring to the first instead, which makes a hollow part.
    """
    count = len(rings[0])
    vertices = np.concatenate(rings)
    around = np.arange(count)
    following = np.roll(around, -1)
    faces = []
    closed = [*range(1, len(rings)), 0] if centre is None else range(1, len(rings))
    for low, high in enumerate(closed):
        a, b = low * count + around, low * count + following
        c, d = high * count + following, high * count + around
        faces += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    if centre is not None:
        top = len(vertices)
        last = (len(rings) - 1) * count
        tips = [[*centre, rings[-1][0, 2]], [*centre, rings[0][0, 2]]]
        vertices = np.concatenate([vertices, tips])
        faces.append(np.stack([last + around, last + following, np.full(count, top)], 1))
        faces.append(np.stack([following, around, np.full(count, top + 1)], 1))
    return Mesh(vertices, np.concatenate(faces))


def inset(polygon: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """A counter-clockwise polygon (n, 2) with every edge moved inwards."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    inward = np.stack([-edge[:, 1], edge[:, 0]], 1)
    before = np.roll(inward, 1, axis=0)
    mitre = (inward + before) / (1 + (inward * before).sum(axis=1, keepdims=True))
    return polygon + distance * mitre


def at_height(polygon: NDArray[np.float64], z: float) -> NDArray[np.float64]:
    """A flat polygon (n, 2) as a ring (n, 3)."""
    return np.column_stack([polygon, np.full(len(polygon), z)])


def extrude(
    polygon: ArrayLike, height: float, bevel: float, centre: tuple[float, float] = (0, 0)
) -> Mesh:
    """A prism standing on z = 0 with bevelled upper and lower edges; `centre` sees its outline."""
    outline = np.asarray(polygon, float)
    small = inset(outline, bevel)
    levels = [(small, 0.0), (outline, bevel), (outline, height - bevel), (small, height)]
    return loft([at_height(shape, z) for shape, z in levels], centre)


def hollow(outer: ArrayLike, inner: ArrayLike, height: float, bevel: float) -> Mesh:
    """A prism with a hole: outlines of equally many points, standing on z = 0."""
    out, hole = np.asarray(outer, float), np.asarray(inner, float)
    small, wide = inset(out, bevel), inset(hole, -bevel)
    levels = [(small, 0.0), (out, bevel), (out, height - bevel), (small, height)]
    levels += [(wide, height), (hole, height - bevel), (hole, bevel), (wide, 0.0)]
    return loft([at_height(shape, z) for shape, z in levels], None)


def polygon(corners: int, radius: float, *, points: int | None = None) -> NDArray[np.float64]:
    """A regular polygon, counter-clockwise; `points` spreads more points along its edges."""
    points = points or corners
    angle = 2 * np.pi * np.arange(points) / points
    sector = np.pi / corners
    reach = radius * np.cos(sector) / np.cos(angle % (2 * sector) - sector)
    return np.stack([reach * np.cos(angle), reach * np.sin(angle)], 1)


def circle(radius: float, points: int = 64) -> NDArray[np.float64]:
    """A circle as a polygon, counter-clockwise."""
    return polygon(points, radius)


def rectangle(width: float, depth: float) -> NDArray[np.float64]:
    """A rectangle around the origin, counter-clockwise."""
    w, d = width / 2, depth / 2
    return np.array([[-w, -d], [w, -d], [w, d], [-w, d]])


def l_outline(leg: float, width: float) -> NDArray[np.float64]:
    """An L with two legs of equal length, its outer corner at the origin."""
    return np.array(
        [[0, 0], [leg, 0], [leg, width], [width, width], [width, leg], [0, leg]], dtype=float
    )


def revolve(profile: ArrayLike, points: int = 64) -> Mesh:
    """A body of revolution about z from (radius, z) pairs, bottom to top, closed at both ends."""
    rings = [at_height(circle(radius, points), z) for radius, z in np.asarray(profile, float)]
    return loft(rings, (0.0, 0.0))


def turn(axis: str, degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return matrix


def from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
