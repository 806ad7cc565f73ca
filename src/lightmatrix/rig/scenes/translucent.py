"""A translucent paper arch over a glossy bowl and board: wide footprints."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig.geometry import Mesh, revolve
from lightmatrix.rig.scenes.scene import Part, Scene, matt, plastic, translucent
from lightmatrix.rig.scenes.shapes import sheet


def build() -> Scene:
    """The scene."""
    outside = [(0.12, 0.0), (0.22, 0.0), (0.37, 0.12), (0.45, 0.28), (0.44, 0.30), (0.425, 0.295)]
    inside = [(0.32, 0.14), (0.20, 0.05), (0.08, 0.03), (0.001, 0.03)]
    parts = (
        Part(sheet(), matt(0.55)),
        Part(revolve([*outside, *inside]).placed((0.45, -0.42, 0)), plastic(0.75, 0.15)),
        Part(_arch().placed((-0.38, 0.30, 0.0)), translucent(0.85, 1.0)),
    )
    description = "a translucent paper arch and a glossy bowl on a board: wide footprints"
    return Scene("translucent", description, parts, max_depth=14)


def _arch(radius: float = 0.5, length: float = 1.0, steps: int = 48) -> Mesh:
    """Half a cylinder of paper standing on its two long edges."""
    angle = np.pi * np.arange(steps + 1) / steps
    x, z = radius * np.cos(angle), 0.6 * radius * np.sin(angle)
    near = np.column_stack([x, np.full_like(x, -length / 2), z])
    far = near + [0, length, 0]
    i = np.arange(steps)
    j = i + steps + 1
    faces = np.concatenate([np.stack([i, i + 1, j + 1], 1), np.stack([i, j + 1, j], 1)])
    return Mesh(np.concatenate([near, far]), faces)
