"""A scene as Mitsuba loads it: meshes, materials, camera and projector."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation.geometry import Mesh
from lightmatrix.simulation.scenes.scene import Scene


def mitsuba_scene(
    mi: ModuleType,
    scene: Scene,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    pattern: NDArray[np.float32] | None = None,
    integrator: dict[str, Any] | None = None,
) -> Any:
    """Load a scene; the projector shows `pattern`, (rows, cols) in [0, 1], or white if None."""
    if pattern is None:
        pattern = np.ones(projector_shape, np.float32)
    content: dict[str, Any] = {
        "type": "scene",
        "integrator": integrator or {"type": "path", "max_depth": scene.max_depth + 1},
        "camera": _camera(mi, scene.camera, camera_shape),
        "projector": _projector(mi, scene.projector, pattern),
    }
    for number, part in enumerate(scene.parts):
        content[f"part{number}"] = _shape(mi, part.mesh, dict(part.material), f"part{number}")
    return mi.load_dict(content)


def _camera(mi: ModuleType, place: tuple[float, float, float], shape: tuple[int, int]) -> Any:
    x, y, z = place
    rows, cols = shape
    # The camera looks straight down, and its shifted film sees the same rectangle of the plane
    # z = 0 as the projector. The paper aligns the two by a homography instead.
    return {
        "type": "perspective",
        "fov": float(2 * np.degrees(np.arctan(1 / z))),
        "fov_axis": "x",
        "near_clip": 0.1,
        "far_clip": 100.0,
        "principal_point_offset_x": -x / 2,
        "principal_point_offset_y": y / 2 * cols / rows,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[x, y, z], target=[x, y, 0], up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": cols,
            "height": rows,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def _projector(
    mi: ModuleType, place: tuple[float, float, float], pattern: NDArray[np.float32]
) -> Any:
    x, y, z = place
    return {
        "type": "projector",
        "fov": float(2 * np.degrees(np.arctan(1 / z))),
        "fov_axis": "x",
        # Mitsuba defines the irradiance at distance 1; this makes it 1 on the plane z = 0.
        "scale": z * z,
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.repeat(pattern[:, :, None], 3, axis=2).astype(np.float32)),
            "raw": True,
            "filter_type": "nearest",
            "wrap_mode": "clamp",
        },
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[x, y, z], target=[x, y, 0], up=[0, 1, 0]
        ),
    }


def _shape(mi: ModuleType, mesh: Mesh, material: dict[str, Any], name: str) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    shape = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
