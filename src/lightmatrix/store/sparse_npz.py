"""Reads sparse matrices from npz files: ours, exported or rendered, and those that SciPy saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.json_files import parse_json
from lightmatrix.files.numpy_files import NpyHeader, read_npz
from lightmatrix.geometry.files import checked_fields
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.outputs.kinds import TRANSPORT_MARK, TRUTH_MARK
from lightmatrix.store.matrix_checks import checked_float32, checked_matrix, checked_shape
from lightmatrix.transport.matrix import LightTransport

# The version of exports and truth files. Files of a later one are refused.
VERSION = 1
_VERSIONS = (TRANSPORT_MARK, TRUTH_MARK)
# Arrays with one value for each entry. All others are small, or have one value for each row and
# cell.
_ENTRIES = ("data", "indices", "row", "col", "direct_data")
# Bytes that any other array may take, such as the metadata. Chosen by hand, far above real files.
_MOST_SMALL = 16 << 20


@dataclass(frozen=True, eq=False)
class SparseFile:
    """The checked content of an npz file."""

    # (M, N) float32; where the file holds the shapes, M and N are their products.
    matrix: csr_array
    # The direct part of each entry, (nnz,).
    direct_data: NDArray[np.float32] | None
    # What the matrix leaves out, (M, rows * cols) of the grid.
    background: NDArray[np.float32] | None
    background_grid: tuple[int, int]
    camera_shape: tuple[int, ...] | None
    projector_shape: tuple[int, int] | None
    metadata: Mapping[str, Any]
    # Of the rig, in a truth file of a rendered scene.
    geometry: RigGeometry | None


def import_npz(
    path: str | Path,
    camera_shape: tuple[int, ...] | None = None,
    projector_shape: tuple[int, int] | None = None,
) -> LightTransport:
    """Read T from npz: an export, a truth, or a SciPy matrix, whose shapes must be known."""
    content = read_sparse_npz(path)
    camera = camera_shape or content.camera_shape
    projector = projector_shape or content.projector_shape
    if camera is None or projector is None:
        raise InputError(
            f"{path}: does not say the shapes of camera and projector",
            hint="give camera_shape and projector_shape",
        )
    background = content.background
    if background is None:
        background = np.zeros((content.matrix.shape[0], 1), np.float32)
    return LightTransport(
        content.matrix,
        background,
        camera,
        projector,
        content.background_grid,
        provenance=dict(content.metadata),
    )


def read_sparse_npz(path: str | Path) -> SparseFile:
    """Read a sparse matrix in CSR, CSC or COO form."""
    file = Path(path)
    content = read_npz(file, _check_headers)
    for name in _VERSIONS:
        if name in content and _text(content[name]) != str(VERSION):
            raise InputError(
                f"{file}: has format version {_text(content[name])[:20]}, this lightmatrix reads "
                f"{VERSION}",
                hint="update lightmatrix",
            )
    try:
        return _checked(file, content)
    except ValueError as error:
        raise InputError(
            f"{file}: contradicts itself: {error}", hint="the file is damaged; write it again"
        ) from error


def _check_headers(headers: Mapping[str, NpyHeader]) -> None:
    """Refuse sizes that no matrix has, before any array is inflated."""
    lacking = [name for name in ("format", "shape", "data") if name not in headers]
    if lacking:
        raise ValueError(f"no sparse matrix: {', '.join(lacking)} missing")
    entries = headers["data"].shape
    if len(entries) != 1:
        raise ValueError("data does not have one value for each entry")
    for name, header in headers.items():
        if name in _ENTRIES:
            if header.shape != entries:
                words = "direct parts" if name == "direct_data" else name
                raise ValueError(f"{header.shape} {words} for {entries[0]} entries")
        elif name not in ("indptr", "background") and header.bytes > _MOST_SMALL:
            raise ValueError(f"{name[:40]!r} holds {header.bytes} bytes")


def _checked(file: Path, content: Mapping[str, NDArray[Any]]) -> SparseFile:
    rows, cols = checked_shape(content["shape"], (2,), "the matrix", pixels=max)
    matrix = _matrix(content, (rows, cols))
    camera, projector = None, None
    if "camera_shape" in content:
        camera = checked_shape(content["camera_shape"], (2, 3), "camera_shape")
    if "projector_shape" in content:
        projector = _pair(content["projector_shape"], "projector_shape")
    for name, shape, length in (("camera", camera, rows), ("projector", projector, cols)):
        if shape is not None and np.prod(shape) != length:
            raise ValueError(
                f"its {name} has {' x '.join(map(str, shape))} pixels, its matrix has {length}"
            )
    grid = (1, 1)
    if "background_grid" in content:
        grid = _pair(content["background_grid"], "background_grid")
    background = content.get("background")
    if background is not None:
        if background.shape != (rows, grid[0] * grid[1]):
            raise ValueError(f"a background of {background.shape}")
        background = checked_float32(background, "the background")
    direct = content.get("direct_data")
    if direct is not None:
        if _text(content["format"]) != "csr":
            raise ValueError("direct parts belong to a matrix in the form csr")
        direct = checked_float32(direct, "the direct part")
    metadata: Any = {}
    if "metadata" in content:
        metadata = parse_json(_text(content["metadata"]), f"{file}: metadata", finite=False)
        if not isinstance(metadata, dict):
            raise ValueError("its metadata is not an object")
    geometry = None
    if "geometry" in content:
        fields = parse_json(_text(content["geometry"]), f"{file}: geometry")
        geometry = RigGeometry(**checked_fields(fields, str(file)))
        if (geometry.camera_shape, geometry.projector_shape) != ((camera or ())[:2], projector):
            raise ValueError("its geometry has other image sizes")
    return SparseFile(matrix, direct, background, grid, camera, projector, metadata, geometry)


def _matrix(content: Mapping[str, NDArray[Any]], shape: tuple[int, int]) -> csr_array:
    rows, cols = shape
    form = _text(content["format"])
    needed = {"csr": ("indices", "indptr"), "csc": ("indices", "indptr"), "coo": ("row", "col")}
    if form not in needed:
        raise ValueError(f"a matrix in the form {form[:20]!r}; save it as csr")
    lacking = [name for name in needed[form] if name not in content]
    if lacking:
        raise ValueError(f"{', '.join(lacking)} missing")
    data = content["data"]
    if form == "csr":
        return checked_matrix(data, content["indices"], content["indptr"], shape)
    if form == "csc":
        flipped = checked_matrix(data, content["indices"], content["indptr"], (cols, rows))
        return csr_array(flipped.T)
    for name, most in (("row", rows), ("col", cols)):
        index = content[name]
        if index.dtype.kind not in "iu" or (index < 0).any() or (index >= most).any():
            raise ValueError(f"a place lies outside the matrix of {rows} x {cols}")
    places = (content["row"].astype(np.int32), content["col"].astype(np.int32))
    return csr_array(coo_array((checked_float32(data, "data"), places), shape=shape))


def _pair(value: NDArray[Any], name: str) -> tuple[int, int]:
    rows, cols = checked_shape(value, (2,), name)
    return rows, cols


def _text(value: NDArray[Any]) -> str:
    """The text of an array that holds a single value."""
    if value.size != 1:
        return "nothing"
    item = value.reshape(-1)[0].item()
    return item.decode("ascii", "replace") if isinstance(item, bytes) else str(item)
