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

from lightmatrix.simulation.geometry import Mesh
from lightmatrix.simulation.scenes.view import View

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
