"""A painted vase seen from the side by a turned camera: a wide baseline and no straight lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation.scenes.scene import Part, Scene, View, matt, painted
from lightmatrix.simulation.scenes.shapes import Mesh, ball, revolve, sheet

# Vertices along the profile and around the vase: finer than the pixels of a megapixel camera would
# see, so that paint and silhouette look smooth.
_ALONG, _AROUND = 128, 192
_LENGTH = 1.1


def build() -> Scene:
    """A vase lying on its side with painted bands and petals, two balls, and a matt sheet."""
    vase = _vase()
    lying = vase.placed((-0.42, -0.42, 0.377), _lying())
    parts = (
        Part(sheet(6.0), matt(0.55)),
        Part(lying, painted(), _paint(vase)),
        Part(ball(0.16).placed((0.62, -0.38, 0.0)), matt(0.8)),
        Part(ball(0.12).placed((-0.55, 0.50, 0.0)), matt(0.35)),
    )
    return Scene(
        "vase",
        "a painted vase and two balls, seen from the side by a turned camera: a wide baseline",
        parts,
        camera=View((-1.6, -0.7, 3.5), target=(0.0, 0.0, 0.15), roll=17.0, width=1.7),
        projector=View((0.55, 0.25, 4.0), target=(0.0, 0.0, 0.15), roll=-6.0),
    )


def _vase() -> Mesh:
    """The vase standing on z = 0: a belly, a neck and a lip."""
    t = np.linspace(0, 1, _ALONG)
    belly = 0.30 * np.exp(-(((t - 0.36) / 0.26) ** 2))
    lip = 0.10 * np.exp(-(((t - 1.0) / 0.09) ** 2))
    return revolve(np.column_stack([0.10 + belly + lip, _LENGTH * t]), _AROUND)


def _lying() -> NDArray[np.float64]:
    """Rotation that lays the vase's axis into the plane, its neck to the upper right."""
    angle = np.radians(35)
    axis = np.array([np.cos(angle), np.sin(angle), 0.06])
    axis /= np.linalg.norm(axis)
    side = np.cross((0, 0, 1), axis)
    side /= np.linalg.norm(side)
    return np.column_stack([np.cross(side, axis), side, axis])


def _paint(vase: Mesh) -> NDArray[np.float64]:
    """Reflectance (V, 3) of the vase's vertices: dark petals on a light glaze between two bands."""
    x, y, z = vase.vertices.T
    around, along = np.arctan2(y, x), z / _LENGTH
    petals = 0.5 + 0.5 * np.sin(9 * around) * np.sin(2 * np.pi * 4.5 * along)
    bands = np.exp(-(((along - 0.74) / 0.02) ** 2)) + np.exp(-(((along - 0.08) / 0.02) ** 2))
    level = 0.25 + 0.55 * np.where(np.abs(petals - 0.5) < 0.22, petals, np.round(petals))
    glaze = level[:, None] * np.array([1.0, 0.92, 0.85])
    blue = np.array([0.10, 0.14, 0.38])
    share = np.clip(bands, 0, 1)[:, None]
    return glaze * (1 - share) + blue * share
