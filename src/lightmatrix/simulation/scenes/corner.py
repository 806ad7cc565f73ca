"""A concave corner of two white walls: strong interreflection, no bright single response."""

from __future__ import annotations

from math import sqrt

import numpy as np

from lightmatrix.simulation.scenes.scene import Part, Scene, View, matt
from lightmatrix.simulation.scenes.shapes import Mesh, ball, box, turn

# Height of the edge where the walls meet: the plane z = 0 cuts the walls, so that half of their lit
# parts lies below it and half above.
EDGE = -0.6
# Objects keep this distance from the walls, so that surfaces do not coincide.
GAP = 0.001


def build() -> Scene:
    """A right-angled valley, its edge along y, with a cube and a ball that cast shadows."""
    side, radius = 0.40, 0.19
    cube = (
        box(side, side, side, 0.012)
        .placed((0, 0, -side / 2), np.eye(3))
        .placed((0.0, 0.42, EDGE + side / sqrt(2) + GAP), turn("y", 45))
    )
    rolled = ball(radius).placed((0.0, -0.40, EDGE + radius * (sqrt(2) - 1) + GAP))
    description = (
        "two white walls, a cube and a ball in the valley between them: strong global light"
    )
    parts = tuple(Part(mesh, matt(0.9)) for mesh in (_valley(), cube, rolled))
    return Scene(
        "corner", description, parts, max_depth=20, version=2, camera=View((-0.3, -0.2, 4.0))
    )


def _valley(rim: float = 1.5, half: float = 3.0) -> Mesh:
    """Two walls at right angles that meet in the line x = 0, z = EDGE."""
    reach = rim - EDGE
    left, right = (
        [[-reach, y, rim] for y in (-half, half)],
        [[reach, y, rim] for y in (-half, half)],
    )
    middle = [[0.0, y, EDGE] for y in (-half, half)]
    faces = [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]
    return Mesh(np.array([*left, *middle, *right], float), np.array(faces))
