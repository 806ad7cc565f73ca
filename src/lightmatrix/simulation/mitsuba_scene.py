"""A scene as Mitsuba loads it: meshes, materials, camera and projector."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation.scenes.scene import Part, Scene
from lightmatrix.simulation.scenes.view import View


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
        content[f"part{number}"] = _shape(mi, part, f"part{number}")
    return mi.load_dict(content)


def _camera(mi: ModuleType, view: View, shape: tuple[int, int]) -> Any:
    rows, cols = shape
    intrinsics = view.intrinsics(shape)
    return {
        "type": "perspective",
        "fov": _field_of_view(view),
        "fov_axis": "x",
        "near_clip": 0.1,
        "far_clip": 100.0,
        # Mitsuba's film moves the other way, in shares of its width and height.
        "principal_point_offset_x": float((cols - 1) / 2 - intrinsics[0, 2]) / cols,
        "principal_point_offset_y": float((rows - 1) / 2 - intrinsics[1, 2]) / rows,
        "to_world": _to_world(mi, view),
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


def _projector(mi: ModuleType, view: View, pattern: NDArray[np.float32]) -> Any:
    return {
        "type": "projector",
        "fov": _field_of_view(view),
        "fov_axis": "x",
        # Mitsuba defines the irradiance at distance 1; this makes it 1 at the target.
        "scale": view.distance**2,
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.repeat(pattern[:, :, None], 3, axis=2).astype(np.float32)),
            "raw": True,
            "filter_type": "nearest",
            "wrap_mode": "clamp",
        },
        "to_world": _to_world(mi, view),
    }


def _field_of_view(view: View) -> float:
    """The angle between the left and the right edge of the image, in degrees."""
    return float(2 * np.degrees(np.arctan(view.width / 2 / view.distance)))


def _to_world(mi: ModuleType, view: View) -> Any:
    _, down, forward = view.axes
    position = np.array(view.position)
    return mi.ScalarTransform4f().look_at(
        origin=position.tolist(), target=(position + forward).tolist(), up=(-down).tolist()
    )


def _shape(mi: ModuleType, part: Part, name: str) -> Any:
    mesh, material = part.mesh, dict(part.material)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    shape = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props=properties)
    if part.colours is not None:
        shape.add_attribute("vertex_color", 3, part.colours.astype(np.float32).ravel())
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
