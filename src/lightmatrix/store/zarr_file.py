"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.memory import check_room
from lightmatrix.files.zarr_arrays import (
    StoredArray,
    damage_explained,
    read_attributes,
    write_array,
)
from lightmatrix.outputs.kinds import PACKED_CAPTURE, PARTIAL, STORE
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.store.checked import checked_diagnostics, checked_matrix, finite, shape_of
from lightmatrix.transport.matrix import LightTransport

FORMAT, VERSION = "lightmatrix-transport", 1
_DIAGNOSTICS = "diagnostics"
_ARRAYS = ("indptr", "indices", "data", "background")
_RESTORE = "restore it, or estimate again"


def save(path: str | Path, transport: LightTransport, *, overwrite: bool = False) -> None:
    """Write a light transport matrix as a Zarr group.

    Parameters
    ----------
    path : str or Path
        Ends in .zarr.
    transport : LightTransport
        What to write.
    overwrite : bool
        Whether an existing one may be replaced; it stays until the new one is whole.

    Raises
    ------
    OutputError
        If it exists, ends otherwise, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("saved.zarr", lm.truth("metal").transport())
    """
    with atomic_folder(path, STORE, overwrite=overwrite) as part:
        group = zarr.open_group(part, mode="w", zarr_format=3)
        sparse = transport.sparse
        arrays: dict[str, NDArray[Any]] = {
            "indptr": np.asarray(sparse.indptr, np.int64),
            "indices": np.asarray(sparse.indices, np.int32),
            "data": np.asarray(sparse.data, np.float32),
            "background": np.asarray(transport.background, np.float32),
        }
        for name, values in arrays.items():
            write_array(group, name, values)
        diagnostics = group.create_group(_DIAGNOSTICS)
        for name, values in transport.diagnostics.items():
            write_array(diagnostics, name, values)
        # Last, so that a group without attributes is never taken for a whole one.
        group.attrs.update(
            {
                "format": FORMAT,
                "version": VERSION,
                "camera_shape": [int(n) for n in transport.camera_shape],
                "projector_shape": [int(n) for n in transport.projector_shape],
                "background_grid": [int(n) for n in transport.background_grid],
                "provenance": json.loads(json.dumps(dict(transport.provenance), default=str)),
            }
        )


def open(path: str | Path) -> LightTransport:
    """Read a light transport matrix.

    Raises
    ------
    InputError
        If there is none, it is incomplete, damaged, of a later format version, or not stored the
        way that `save` does. All of it is checked: indices, finite values, shapes.
    """
    place = Path(path)
    if not place.exists():
        if place.with_name(place.name + PARTIAL).exists():
            raise InputError(
                f"{place}: the estimate is incomplete",
                hint="run the same `lightmatrix estimate` again; it goes on where it stopped",
            )
        raise InputError(f"{place}: no such file", hint="check the name")
    wrong = InputError(
        f"{place}: is not a light transport matrix", hint="give a .zarr folder from `estimate`"
    )
    attributes = read_attributes(place)
    if attributes.get("format") != FORMAT:
        output = attributes.get("output")
        if isinstance(output, dict) and output.get("kind") == PACKED_CAPTURE.name:
            raise InputError(
                f"{place}: is a {PACKED_CAPTURE.name}, not a {STORE.name}",
                hint="estimate one from it: lightmatrix estimate",
            )
        raise wrong
    if attributes.get("version") != VERSION:
        raise InputError(
            f"{place}: has format version {str(attributes.get('version'))[:20]}, this lightmatrix "
            f"reads {VERSION}",
            hint="update lightmatrix",
        )
    with damage_explained(place, _RESTORE):
        arrays = _arrays(place, attributes)
    check_room(place, sum(array.bytes for array in arrays.values()))
    with damage_explained(place, _RESTORE):
        return _read(attributes, arrays)


def _shapes(attributes: dict[str, Any]) -> tuple[tuple[int, ...], tuple[int, int], tuple[int, int]]:
    """Shapes of camera, projector and background grid."""
    camera = shape_of(attributes["camera_shape"], (2, 3), "camera_shape")
    rows, cols = shape_of(attributes["projector_shape"], (2,), "projector_shape")
    grid_rows, grid_cols = shape_of(attributes["background_grid"], (2,), "background_grid")
    return camera, (rows, cols), (grid_rows, grid_cols)


def _arrays(place: Path, attributes: dict[str, Any]) -> dict[str, StoredArray]:
    """The arrays of a store, if what they announce fits together."""
    camera, _, grid = _shapes(attributes)
    samples = math.prod(camera)
    names = sorted(entry.name for entry in (place / _DIAGNOSTICS).iterdir() if entry.is_dir())
    members = [*_ARRAYS, *(f"{_DIAGNOSTICS}/{name}" for name in names)]
    arrays = {name: StoredArray.open(place / name) for name in members}
    wanted = {
        "indptr": (samples + 1,),
        "indices": arrays["data"].shape,
        "background": (samples, math.prod(grid)),
        **{name: (samples,) for name in arrays if name.startswith(_DIAGNOSTICS)},
    }
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, not {shape}")
    return arrays


def _read(attributes: dict[str, Any], arrays: dict[str, StoredArray]) -> LightTransport:
    camera, projector, grid = _shapes(attributes)
    provenance = attributes["provenance"]
    if not isinstance(provenance, dict):
        raise ValueError("its provenance is not an object")
    read = {name: array.read() for name, array in arrays.items()}
    shape = (math.prod(camera), math.prod(projector))
    diagnostics = {
        name.removeprefix(f"{_DIAGNOSTICS}/"): values
        for name, values in read.items()
        if name not in _ARRAYS
    }
    return LightTransport(
        checked_matrix(read["data"], read["indices"], read["indptr"], shape),
        finite(read["background"], "background"),
        camera,
        projector,
        grid,
        checked_diagnostics(diagnostics, shape[0]),
        provenance,
    )
