"""Translucent paper and glossy crockery on a board: wide footprints."""

from __future__ import annotations

import numpy as np

from lightmatrix.simulation.scenes.scene import Part, Scene, matt, plastic, translucent
from lightmatrix.simulation.scenes.shapes import Mesh, box, revolve, sheet, turn

PAPER = translucent(0.88, 1.1)
GLAZE = plastic((0.72, 0.70, 0.66), 0.14)


def build() -> Scene:
    """A corrugated sheet on bars, a bowl, and a paper cup through which light scatters."""
    parts = [
        Part(sheet(), matt(0.55)),
        Part(_bowl().placed((0.44, -0.42, 0.0)), GLAZE),
        Part(_cup().placed((0.50, 0.52, 0.0)), PAPER),
    ]
    leaning = turn("z", 12)
    for x in (-0.36, 0.36):
        bar = box(0.07, 1.30, 0.16, 0.012).placed((x, 0.0, 0.0))
        parts.append(Part(bar.placed((-0.46, 0.12, 0.0), leaning), matt(0.3)))
    parts.append(Part(_corrugated().placed((-0.46, 0.12, 0.0), leaning), PAPER))
    description = (
        "a corrugated sheet and a cup of translucent paper, a glazed bowl: wide footprints"
    )
    return Scene("translucent", description, tuple(parts), max_depth=14, version=2)


def _bowl() -> Mesh:
    """A bowl with a foot and a rounded rim, turned from a smooth profile."""
    t = np.linspace(0, np.pi / 2, 16)
    foot = [(0.10, 0.0), (0.17, 0.0), (0.18, 0.02)]
    outside = [(0.18 + 0.26 * np.sin(a), 0.04 + 0.24 * (1 - np.cos(a))) for a in t]
    # A half circle of radius 0.012 between the walls.
    lip = [(0.428 + 0.012 * np.cos(a), 0.28 + 0.012 * np.sin(a)) for a in np.linspace(0, np.pi, 8)]
    inside = [(0.416 * np.sin(a), 0.05 + 0.23 * (1 - np.cos(a))) for a in t[::-1]]
    profile = [*foot, *outside, *lip, *inside[:-1], (0.001, 0.05)]
    return revolve(profile, 96)


def _cup() -> Mesh:
    """A paper cup, open at the top: one surface that scatters to both sides."""
    steps = np.linspace(0, 1, 8)
    profile = [(0.001, 0.004), (0.22, 0.004), *((0.22 + 0.08 * s, 0.004 + 0.36 * s) for s in steps)]
    closed = revolve(profile, 96)
    # `revolve` closes both ends; the fan over the opening is left out.
    top = len(closed.vertices) - 2
    return Mesh(closed.vertices, closed.faces[~(closed.faces == top).any(axis=1)])


def _corrugated(width: float = 0.86, length: float = 1.12, waves: int = 7) -> Mesh:
    """A sheet with waves along x whose troughs touch bars of height 0.16."""
    steps = 12 * waves
    x = np.linspace(-width / 2, width / 2, steps + 1)
    z = 0.161 + 0.028 * (1 - np.cos(2 * np.pi * waves * x / width + np.pi * (waves % 2)))
    near = np.column_stack([x, np.full_like(x, -length / 2), z])
    far = near + np.array([0, length, 0])
    i = np.arange(steps)
    j = i + steps + 1
    faces = np.concatenate([np.stack([i, i + 1, j + 1], 1), np.stack([i, j + 1, j], 1)])
    return Mesh(np.concatenate([near, far]), faces)
