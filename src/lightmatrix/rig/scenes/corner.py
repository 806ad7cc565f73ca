"""A concave corner of two white walls: strong interreflection, no bright single response."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig.geometry import Mesh
from lightmatrix.rig.scenes.scene import Part, Scene, matt
from lightmatrix.rig.scenes.shapes import box


def build() -> Scene:
    """The scene: a right-angled valley open towards the rig, its edge along y."""
    # The plane of the field of view cuts the walls, so that their lit parts lie half below it and
    # half above.
    edge, rim, half = -0.6, 1.5, 3.0
    reach = rim - edge
    vertices = [
        [-reach, -half, rim],
        [0.0, -half, edge],
        [0.0, half, edge],
        [-reach, half, rim],
        [reach, -half, rim],
        [reach, half, rim],
    ]
    faces = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]
    valley = Mesh(np.array(vertices, float), np.array(faces))
    # A small block stands in the valley, so that its shadows hold global light only.
    tilt = np.array([[1, 0, 1], [0, np.sqrt(2), 0], [-1, 0, 1]]) / np.sqrt(2)
    block = box(0.26, 0.30, 0.22, 0.02).placed((-0.40, 0.25, -0.10), tilt)
    description = "two white walls that meet in a valley and light each other"
    parts = (Part(valley, matt(0.9)), Part(block, matt(0.9)))
    return Scene("corner", description, parts, max_depth=20, camera=(-0.3, -0.2, 4.0))
