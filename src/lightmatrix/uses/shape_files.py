"""A shape as files: points or triangles as PLY, depth as TIFF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from lightmatrix.files.ply import fill_ply
from lightmatrix.outputs.kinds import CLOUD, DEPTH
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
        fill_ply(part, attributes, triangles)


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
