"""Writes PLY files (Turk 1994): points with attributes, and triangles between them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.outputs.kinds import PLY_MARK

_NAMES = {"f4": "float", "u1": "uchar"}


def fill_ply(
    path: Path, attributes: Mapping[str, NDArray[Any]], faces: NDArray[np.integer] | None = None
) -> None:
    """Write points, each attribute (n,) float32 or uint8, and triangles (m, 3), in binary."""
    columns = {name: np.asarray(values) for name, values in attributes.items()}
    count = len(next(iter(columns.values())))
    kinds = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    points = np.empty(count, kinds)
    for name, values in columns.items():
        points[name] = values
    lines = ["ply", "format binary_little_endian 1.0", PLY_MARK, f"element vertex {count}"]
    lines += [f"property {_NAMES[kind.str[1:]]} {name}" for name, kind in kinds]
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
