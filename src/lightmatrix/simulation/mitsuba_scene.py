"""A scene as Mitsuba loads it: meshes, materials, camera and projector."""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import subprocess
import sys
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import MissingExtraError, warn
from lightmatrix.simulation.scenes import Part, Scene, View

# Computes with the LLVM variant.
_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr;"
    "assert dr.sum(mi.Float([1, 2]))[0] == 3"
)
# Folders in which Linux distributions and Homebrew install libLLVM.
_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/opt/homebrew/opt/llvm/lib",
)


@cache
def usable_llvm() -> str | None:
    """Path of a libLLVM that works; "" if the renderer has its own; None if there is none."""
    # Mitsuba's fast variants compile through libLLVM. Version 14 is refused, and 15 and 16 abort
    # the whole process. So newer ones are tried in a child process, the newest first.
    versions: dict[str, int] = {}
    for folder in _FOLDERS:
        for path in glob.glob(f"{folder}/libLLVM*"):
            match = re.search(r"libLLVM[-.](?:so\.|dylib\.)?(\d+)", os.path.basename(path))
            if match and int(match[1]) >= 17:
                versions[os.path.realpath(path)] = int(match[1])
    own = os.environ.get("DRJIT_LIBLLVM_PATH")
    for path in [own] if own else [*sorted(versions, key=lambda path: -versions[path]), ""]:
        environment = {**os.environ, "DRJIT_LIBLLVM_PATH": path} if path else dict(os.environ)
        command = [sys.executable, "-c", _PROBE]
        try:
            probe = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=120
            )
        except subprocess.TimeoutExpired:
            continue
        if probe.returncode == 0:
            return path
    return None


def load_mitsuba(*, scalar: bool = False) -> tuple[ModuleType, bool]:
    """Mitsuba and whether it is the LLVM variant; warns if only the slow one is usable."""
    if importlib.util.find_spec("mitsuba") is None:
        raise MissingExtraError(
            "rendering needs Mitsuba 3, which is not installed",
            hint="from the source folder: .venv/bin/pip install -e '.[render]'",
        )
    llvm = None if scalar else usable_llvm()
    if llvm:
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba

    mi: Any = mitsuba
    mi.set_variant("scalar_rgb" if llvm is None else "llvm_ad_rgb")
    if llvm is None and not scalar:
        _warn_once_of_slowness()
    return mi, llvm is not None


@cache
def _warn_once_of_slowness() -> None:
    warn(
        "no usable LLVM was found, so the scalar renderer is used, about a hundred times slower; "
        "on Debian and Ubuntu: apt-get install libllvm19 (or `make system-deps`)",
    )


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
    rows, cols = camera_shape
    intrinsics = scene.camera.intrinsics(camera_shape)
    content: dict[str, Any] = {
        "type": "scene",
        "integrator": integrator or {"type": "path", "max_depth": scene.max_depth + 1},
        "camera": {
            "type": "perspective",
            **_pose(mi, scene.camera),
            "near_clip": 0.1,
            "far_clip": 100.0,
            # Mitsuba's film moves the other way, in shares of its width and height.
            "principal_point_offset_x": float((cols - 1) / 2 - intrinsics[0, 2]) / cols,
            "principal_point_offset_y": float((rows - 1) / 2 - intrinsics[1, 2]) / rows,
            "film": {
                "type": "hdrfilm",
                "width": cols,
                "height": rows,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
        "projector": {
            "type": "projector",
            **_pose(mi, scene.projector),
            # Mitsuba defines the irradiance at distance 1; this makes it 1 at the target.
            "scale": scene.projector.distance**2,
            "irradiance": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.repeat(pattern[:, :, None], 3, axis=2).astype(np.float32)),
                "raw": True,
                "filter_type": "nearest",
                "wrap_mode": "clamp",
            },
        },
    }
    for number, part in enumerate(scene.parts):
        content[f"part{number}"] = _shape(mi, part, f"part{number}")
    return mi.load_dict(content)


def _pose(mi: ModuleType, view: View) -> dict[str, Any]:
    """Where a device stands, and the angle between the left and the right edge of its image."""
    _, down, forward = view.axes
    position = np.array(view.position)
    return {
        "fov": float(2 * np.degrees(np.arctan(view.width / 2 / view.distance))),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=position.tolist(), target=(position + forward).tolist(), up=(-down).tolist()
        ),
    }


def _shape(mi: ModuleType, part: Part, name: str) -> Any:
    mesh, properties = part.mesh, mi.Properties()
    properties["bsdf"] = mi.load_dict(dict(part.material))
    shape = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props=properties)
    if part.colours is not None:
        shape.add_attribute("vertex_color", 3, part.colours.astype(np.float32).ravel())
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
