"""The scenes' geometry: closed, resting on something, apart from each other, well described."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lightmatrix.simulation.scenes import names, scene
from lightmatrix.simulation.shapes import Mesh, ball, box, bracket, l_block, nut, ring, rod


def volume(mesh: Mesh) -> float:
    """Signed volume: positive where faces are counter-clockwise seen from outside."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def open_edges(mesh: Mesh) -> int:
    """Edges that do not join exactly two faces that run along it in opposite directions."""
    edges = np.concatenate([mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    key = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    back = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    return int((~np.isin(key, back)).sum())


SHAPES = {
    "box": (box(0.4, 0.3, 0.2, 0.02), 0.4 * 0.3 * 0.2),
    "ball": (ball(0.3), 4 / 3 * np.pi * 0.3**3),
    "ring": (ring(0.3, 0.2, 0.1), np.pi * (0.3**2 - 0.2**2) * 0.1),
    "rod": (rod(0.1, 0.5), np.pi * 0.1**2 * 0.5),
    "l_block": (l_block(0.5, 0.2, 0.2), (0.5 * 0.2 + 0.3 * 0.2) * 0.2),
    "bracket": (bracket(0.4, 0.05, 0.3), (0.4 * 0.05 + 0.35 * 0.05) * 0.3),
    "nut": (nut(0.2, 0.1, 0.1), (3 * np.sqrt(3) / 2 * 0.2**2 - np.pi * 0.1**2) * 0.1),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_are_closed_and_face_outwards(name: str) -> None:
    mesh, expected = SHAPES[name]
    assert open_edges(mesh) == 0
    # Bevels and facets take a little away.
    assert 0.9 * expected < volume(mesh) < 1.001 * expected


@pytest.mark.parametrize("name", names())
def test_scenes_rest_on_the_table(name: str) -> None:
    built = scene(name)
    assert built.name == name
    assert 10 < len(built.description) < 90
    assert not built.description.endswith(".")
    for part in built.parts:
        assert np.isfinite(part.mesh.vertices).all()
        assert part.mesh.faces.min() >= 0
        assert part.mesh.faces.max() < len(part.mesh.vertices)
    if name not in ("corner", "stage"):  # whose walls meet below the plane of the field of view
        lowest = [part.mesh.vertices[:, 2].min() for part in built.parts]
        # The mirror stands in a slot; a curtain hangs.
        assert min(lowest) > (-0.02 if name == "mirror" else -1e-3)
        assert max(part.mesh.vertices[:, 2].max() for part in built.parts) < 1.4


@pytest.mark.parametrize("name", ["l_objects", "metal"])
def test_piled_bodies_touch_something_and_do_not_pass_through_each_other(name: str) -> None:
    bodies = [part.mesh for part in scene(name).parts[1:]]
    gaps = np.full((len(bodies), len(bodies)), np.inf)
    for i, one in enumerate(bodies):
        for j, other in enumerate(bodies):
            if i != j and boxes_near(one, other):
                depth = deepest_inside(one, other)
                assert depth < 0.01, f"body {i} is {depth:.3f} inside body {j}"
                gaps[i, j] = distance(one, other)
    for i, body in enumerate(bodies):
        height = body.vertices[:, 2].min()
        nearest = min(height, gaps[i].min(), gaps[:, i].min())
        assert nearest < 0.02, f"body {i} floats {nearest:.3f} above everything"


def boxes_near(one: Mesh, other: Mesh, gap: float = 0.03) -> bool:
    low, high = one.vertices.min(axis=0) - gap, one.vertices.max(axis=0) + gap
    return bool(
        (other.vertices.min(axis=0) <= high).all() and (other.vertices.max(axis=0) >= low).all()
    )


def surface_points(mesh: Mesh, count: int) -> NDArray[np.float64]:
    """Points spread evenly over the surface."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    random = np.random.default_rng(0)
    face = random.choice(len(area), count, p=area / area.sum())
    return np.asarray(np.einsum("pcx,pc->px", corners[face], random.dirichlet([1, 1, 1], count)))


def probes(mesh: Mesh) -> NDArray[np.float64]:
    return np.concatenate(
        [mesh.vertices[:: max(1, len(mesh.vertices) // 300)], surface_points(mesh, 300)]
    )


def deepest_inside(one: Mesh, other: Mesh) -> float:
    """How far points of `one` are inside `other`, judged by winding and distance to its faces."""
    points = probes(one)
    low, high = other.vertices.min(axis=0), other.vertices.max(axis=0)
    points = points[((points > low) & (points < high)).all(axis=1)]
    if not len(points):
        return 0.0
    inside = np.abs(winding(points, other)) > 0.5
    return float(to_faces(points[inside], other).max()) if inside.any() else 0.0


def distance(one: Mesh, other: Mesh) -> float:
    low, high = other.vertices.min(axis=0) - 0.03, other.vertices.max(axis=0) + 0.03
    points = probes(one)
    points = points[((points > low) & (points < high)).all(axis=1)]
    return float(to_faces(points, other).min()) if len(points) else np.inf


def winding(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.float64]:
    """Winding number from the solid angles of all faces (van Oosterom & Strackee 1983)."""
    total = np.zeros(len(points))
    for face in mesh.vertices[mesh.faces]:
        a, b, c = (corner - points for corner in face)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        triple = (a * np.cross(b, c)).sum(axis=1)
        flat = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total += 2 * np.arctan2(triple, flat)
    return total / (4 * np.pi)


# A mesh and the tree of many points on its surface, by the identity of the mesh.
_TREES: dict[int, tuple[Mesh, cKDTree]] = {}


def to_faces(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.float64]:
    """Distance of each point to the nearest of many points on the surface."""
    if id(mesh) not in _TREES:
        _TREES[id(mesh)] = mesh, cKDTree(surface_points(mesh, 20_000))
    return np.asarray(_TREES[id(mesh)][1].query(points)[0])
