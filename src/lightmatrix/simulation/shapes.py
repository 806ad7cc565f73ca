"""The parts that scenes are built from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Meshes of the scenes, lofted through rings of points so that edges can be bevelled.


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64 in scene units, faces (F, 3) int."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    def placed(
        self, position: ArrayLike = (0, 0, 0), rotation: NDArray[np.float64] | None = None
    ) -> "Mesh":
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


def l_outline(leg: float, width: float) -> NDArray[np.float64]:
    """An L with two legs of equal length, its outer corner at the origin."""
    return np.array(
        [[0, 0], [leg, 0], [leg, width], [width, width], [width, leg], [0, leg]], dtype=float
    )


def revolve(profile: ArrayLike, points: int = 64) -> Mesh:
    """A body of revolution about z from (radius, z) pairs, bottom to top, closed at both ends."""
    unit = polygon(points, 1)
    rings = [at_height(radius * unit, z) for radius, z in np.asarray(profile, float)]
    return loft(rings, (0.0, 0.0))


def turn(axis: str, degrees: float) -> NDArray[np.float64]:
    """Rotation matrix about a coordinate axis."""
    half = np.radians(degrees) / 2
    return rotation(np.cos(half), np.sin(half) * np.eye(3)["xyz".index(axis)])


def rotation(w: float, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix of a quaternion of length 1."""
    crossed = np.cross(xyz, np.eye(3)).T
    return np.asarray(np.eye(3) + 2 * (w * crossed + crossed @ crossed))


def sheet(size: float = 4.0) -> Mesh:
    """A flat square on z = 0."""
    half = size / 2
    corners = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    return Mesh(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]))


def l_block(leg: float, width: float, height: float) -> Mesh:
    """An L-shaped block lying flat, its middle at the origin in all three axes."""
    block = extrude(l_outline(leg, width), height, 0.05 * width, (width / 2, width / 2))
    return block.placed((-leg / 2, -leg / 2, -height / 2))


def bolt(radius: float, length: float, head_radius: float, head_height: float) -> Mesh:
    """A hexagon bolt along z, its head below; the middle of its length at the origin."""
    head = extrude(polygon(6, head_radius), head_height, 0.12 * head_height)
    threads = []
    pitch = 0.3 * radius
    z = head_height + 0.35 * length
    while z + pitch < head_height + length - pitch:
        threads += [(0.93 * radius, z), (radius, z + pitch / 2)]
        z += pitch
    end = head_height + length
    profile = [(radius, 0.5 * head_height), (radius, head_height + 0.34 * length), *threads]
    profile += [(0.95 * radius, end - 0.2 * radius), (0.75 * radius, end)]
    shaft = revolve(profile, 40)
    return merge([head, shaft]).placed((0, 0, -end / 2))


def nut(radius: float, hole: float, height: float) -> Mesh:
    """A hexagon nut standing on z = -height / 2."""
    ring = hollow(polygon(6, radius, points=48), polygon(48, hole), height, 0.08 * height)
    return ring.placed((0, 0, -height / 2))


def ring(radius: float, hole: float, height: float) -> Mesh:
    """A washer or bearing ring standing on z = -height / 2."""
    body = hollow(polygon(64, radius), polygon(64, hole), height, 0.1 * min(height, radius - hole))
    return body.placed((0, 0, -height / 2))


def bracket(leg: float, thickness: float, width: float) -> Mesh:
    """A bent plate: an L profile of the given width, its middle at the origin, lying on a side."""
    profile = extrude(l_outline(leg, thickness), width, 0.15 * thickness, (thickness / 2,) * 2)
    return profile.placed((-leg / 2, -leg / 2, -width / 2))


def box(width: float, depth: float, height: float, bevel: float) -> Mesh:
    """A box standing on z = 0 with bevelled upper and lower edges."""
    w, d = width / 2, depth / 2
    return extrude([[-w, -d], [w, -d], [w, d], [-w, d]], height, bevel)


def rod(radius: float, length: float) -> Mesh:
    """A round rod along x, its middle at the origin."""
    profile = [
        (0.85 * radius, -length / 2),
        (radius, -length / 2 + 0.15 * radius),
        (radius, length / 2 - 0.15 * radius),
        (0.85 * radius, length / 2),
    ]
    return revolve(profile).placed(rotation=turn("y", 90))


def ball(radius: float, steps: int = 32) -> Mesh:
    """A ball standing on z = 0."""
    angle = np.pi * (np.arange(steps) + 0.5) / steps - np.pi / 2
    return revolve(np.column_stack([radius * np.cos(angle), radius * (1 + np.sin(angle))]))
