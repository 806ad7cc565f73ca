"""A flat white wall: the control, where T is nearly the identity and nothing is global."""

from __future__ import annotations

from lightmatrix.simulation.scenes.scene import Part, Scene, matt
from lightmatrix.simulation.scenes.shapes import sheet


def build() -> Scene:
    """The scene."""
    return Scene("wall", "a flat white wall: direct light only", (Part(sheet(), matt(0.8)),), 2)
