"""`Scene`: meshes and materials above the plane z = 0, seen and lit from above.

Camera and projector look straight down by default. Both then see the square |x|, |y| <= 1 of the
plane z = 0, as after the paper's alignment by a homography, and points above the plane with
parallax. A `View` with a target is turned towards it instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation.scenes.shapes import Mesh

# `View`: where a camera or a projector of a scene stands, and what it sees or lights.


# Every device covers this width of the plane through its target: the square |x|, |y| <= 1.
WIDTH = 2.0


@dataclass(frozen=True)
class View:
    """A device at a position that looks at a target.

    Parameters
    ----------
    position : (x, y, z)
        Its centre.
    target : (x, y, z), optional
        The point in the middle of its image. None: it looks straight down, and its film is shifted
        such that it covers the square |x|, |y| <= 1 of the plane z = 0.
    roll : float
        How far it is turned about its axis, in degrees, clockwise as seen from behind.
    width : float
        Width of its image in the plane through the target at right angles to the axis.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float] | None = None
    roll: float = 0.0
    width: float = WIDTH

    @property
    def distance(self) -> float:
        """From the centre to the target, or straight down to the plane z = 0."""
        if self.target is None:
            return self.position[2]
        return float(np.linalg.norm(np.subtract(self.target, self.position)))

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors (3, 3): to the right, down and forwards in its image."""
        x, y, _ = self.position
        forward = np.subtract((x, y, 0) if self.target is None else self.target, self.position)
        forward = forward / np.linalg.norm(forward)
        # The scene's y points up in an image that is not turned.
        right = np.cross(forward, (0, 1, 0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        c, s = np.cos(np.radians(self.roll)), np.sin(np.radians(self.roll))
        return np.stack([c * right + s * down, c * down - s * right, forward])

    def intrinsics(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """K (3, 3) for an image of (rows, cols) with pixel centres at whole numbers."""
        rows, cols = shape
        focal = cols * self.distance / self.width
        # A shifted film keeps the middle of the square in the middle of the image.
        x, y = (self.position[0], self.position[1]) if self.target is None else (0.0, 0.0)
        across, down = x * cols / self.width, -y * cols / self.width
        return np.array(
            [
                [focal, 0, (cols - 1) / 2 + across],
                [0, focal, (rows - 1) / 2 + down],
                [0, 0, 1],
            ]
        )

    def matrix(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """The projection (3, 4) of (x, y, z, 1) to (col, row, 1) for an image of (rows, cols)."""
        turn = self.axes
        return self.intrinsics(shape) @ np.column_stack([turn, -turn @ self.position])


Material = Mapping[str, Any]
# Where camera and projector stand in most scenes.
_CAMERA, _PROJECTOR = View((-0.8, -0.5, 4.0)), View((0.0, 0.0, 4.0))


def matt(reflectance: float | tuple[float, float, float]) -> Material:
    """A diffuse surface, seen from both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _rgb(reflectance)}}


def painted() -> Material:
    """A diffuse surface whose reflectance varies: `Part.colours`, between vertices linearly."""
    texture = {"type": "mesh_attribute", "name": "vertex_color"}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}


def plastic(reflectance: float | tuple[float, float, float], roughness: float) -> Material:
    """A glossy coat over a diffuse base."""
    base = {"type": "roughplastic", "diffuse_reflectance": _rgb(reflectance), "alpha": roughness}
    return {"type": "twosided", "bsdf": base}


def metal(kind: str, roughness: float) -> Material:
    """A rough conductor; a mirror (roughness below 0.12) would never reflect a pinhole light."""
    base = {"type": "roughconductor", "material": kind, "alpha": roughness}
    return {"type": "twosided", "bsdf": base}


def translucent(reflectance: float, through: float) -> Material:
    """A thin sheet that scatters light to both sides; `through` in [0, 2], 1 sends half through."""
    return {
        "type": "principledthin",
        "base_color": _rgb(reflectance),
        "diff_trans": through,
        "roughness": 0.6,
        "spec_trans": 0.0,
        "eta": 1.3,
    }


def _rgb(value: float | tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [value] * 3 if isinstance(value, float) else list(value)}


@dataclass(frozen=True)
class Part:
    """A mesh and its material; `painted` materials take a colour (V, 3) for each vertex."""

    mesh: Mesh
    material: Material
    colours: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Scene:
    """A scene of the simulator: everything that reflects light, the camera and the projector."""

    name: str
    description: str
    parts: tuple[Part, ...]
    # The longest light path, in surface interactions.
    max_depth: int = 10
    # Raised whenever the scene changes, so that cached matrices are rendered again.
    version: int = 1
    camera: View = _CAMERA
    # Its image is centred on its axis, since Mitsuba's projector has no shifted film.
    projector: View = _PROJECTOR
