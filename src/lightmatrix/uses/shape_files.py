"""A shape as files: points or triangles as PLY, depth as TIFF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from lightmatrix.outputs.kinds import CLOUD, DEPTH, PLY_MARK
from lightmatrix.outputs.writing import atomic_file

# Albedos at this quantile are shown white, as (light) ** (1 / 2.2), which screens undo.
_WHITE_QUANTILE, _GAMMA = 0.99, 2.2


def write_cloud(
    path: str | Path,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    albedo: NDArray[np.float32],
    uncertainty: NDArray[np.float32],
    faces: NDArray[np.int64] | None,
    *,
    overwrite: bool,
) -> None:
    """Write the points (rows, cols, 3) that are known, with triangles of pixel numbers (n, 3)."""
    known = np.isfinite(points).all(axis=-1).ravel()
    grey = grey_levels(albedo).ravel()[known]
    attributes: dict[str, NDArray[Any]] = {}
    vectors = {("x", "y", "z"): points, ("nx", "ny", "nz"): np.nan_to_num(normals)}
    for names, vector in vectors.items():
        for axis, name in enumerate(names):
            attributes[name] = vector[..., axis].ravel()[known].astype(np.float32)
    attributes |= dict.fromkeys(("red", "green", "blue"), grey)
    attributes["uncertainty"] = uncertainty.ravel()[known].astype(np.float32)
    triangles = None
    if faces is not None:
        number = np.cumsum(known) - 1
        triangles = number[faces]
    with atomic_file(path, CLOUD, overwrite=overwrite) as part:
        _fill_ply(part, attributes, triangles)


def write_depth(path: str | Path, depth: NDArray[np.float32], *, overwrite: bool) -> None:
    """Write a depth map (rows, cols) as float32, NaN where there is no depth."""
    with atomic_file(path, DEPTH, overwrite=overwrite) as part:
        if part.suffix.lower() == ".npy":
            np.save(part, depth)
        else:
            tifffile.imwrite(part, depth)


def grey_levels(albedo: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Albedo as grey values for a screen, uint8."""
    bright = float(np.quantile(albedo, _WHITE_QUANTILE)) if albedo.size else 0.0
    share = np.clip(albedo / max(bright, 1e-12), 0, 1)
    return np.rint(255 * share ** (1 / _GAMMA)).astype(np.uint8)


def _fill_ply(
    path: Path, attributes: Mapping[str, NDArray[Any]], faces: NDArray[np.integer] | None = None
) -> None:
    """Write a PLY file (Turk 1994) in binary.

    It has points, each attribute (n,) float32 or uint8, and triangles (m, 3) between them.
    """
    names = {"f4": "float", "u1": "uchar"}
    columns = {name: np.asarray(values) for name, values in attributes.items()}
    count = len(next(iter(columns.values())))
    kinds = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    points = np.empty(count, kinds)
    for name, values in columns.items():
        points[name] = values
    lines = ["ply", "format binary_little_endian 1.0", PLY_MARK, f"element vertex {count}"]
    lines += [f"property {names[kind.str[1:]]} {name}" for name, kind in kinds]
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    with path.open("wb") as stream:
        stream.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
        stream.write(points.tobytes())
        if faces is not None:
            triangles = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
            triangles["count"] = 3
            triangles["corners"] = faces
            stream.write(triangles.tobytes())
