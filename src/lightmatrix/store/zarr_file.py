"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import (
    GrowingArray,
    StoredArray,
    damage_explained,
    read_attributes,
)
from lightmatrix.outputs.kinds import PACKED_CAPTURE, PARTIAL, STORE
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.resources.memory import check_room
from lightmatrix.store.checked import checked_diagnostics, checked_matrix, finite, shape_of
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

FORMAT, VERSION = "lightmatrix-transport", 1
_DIAGNOSTICS = "diagnostics"
# The arrays of the group, and what they are stored as.
_ARRAYS = {"indptr": np.int64, "indices": np.int32, "data": np.float32, "background": np.float32}
RESTORE = "restore it from a copy, or run `lightmatrix estimate --overwrite` again"


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
    rows = SparseRows(transport.sparse, transport.background, transport.diagnostics)
    save_rows(
        path,
        [rows],
        camera_shape=transport.camera_shape,
        projector_shape=transport.projector_shape,
        background_grid=transport.background_grid,
        provenance=transport.provenance,
        overwrite=overwrite,
    )


def save_rows(
    path: str | Path,
    parts: Iterable[SparseRows],
    *,
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, int],
    background_grid: tuple[int, int],
    provenance: Mapping[str, Any],
    overwrite: bool = False,
) -> None:
    """Write a light transport matrix as `save` does, of which no more than a part is in memory.

    Parameters
    ----------
    path : str or Path
        Ends in .zarr.
    parts : iterable of SparseRows
        All rows in their order, one part or more, all with the same diagnostics.
    camera_shape, projector_shape, background_grid : tuple of int
    provenance : mapping
        JSON-ready.
    overwrite : bool
        Whether an existing one may be replaced; it stays until the new one is whole.

    Raises
    ------
    OutputError
        If it exists, ends otherwise, or cannot be written.
    """
    with atomic_folder(path, STORE, overwrite=overwrite) as part:
        group = zarr.open_group(part, mode="w", zarr_format=3)
        arrays = {name: GrowingArray(group, name, dtype) for name, dtype in _ARRAYS.items()}
        told: dict[str, GrowingArray] = {}
        inner = group.create_group(_DIAGNOSTICS)
        arrays["indptr"].add(np.zeros(1, np.int64))
        entries = 0
        for rows in parts:
            matrix = rows.coefficients
            arrays["indptr"].add(entries + matrix.indptr[1:].astype(np.int64))
            arrays["indices"].add(matrix.indices)
            arrays["data"].add(matrix.data)
            arrays["background"].add(rows.background)
            entries += int(matrix.nnz)
            for name, values in rows.diagnostics.items():
                if name not in told:
                    told[name] = GrowingArray(inner, name, values.dtype)
                told[name].add(values)
        for array in (*arrays.values(), *told.values()):
            array.close()
        # Last, so that a group without attributes is never taken for a whole one.
        group.attrs.update(
            {
                "format": FORMAT,
                "version": VERSION,
                "camera_shape": [int(n) for n in camera_shape],
                "projector_shape": [int(n) for n in projector_shape],
                "background_grid": [int(n) for n in background_grid],
                "provenance": json.loads(json.dumps(dict(provenance), default=str)),
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
    return read_whole(look(path))


@dataclass(frozen=True, eq=False)
class Stored:
    """What a store announces; its arrays are not read yet.

    Parameters
    ----------
    place : Path
    camera_shape, projector_shape, background_grid : tuple of int
    provenance : mapping
    arrays : mapping of str to StoredArray
        ``indptr``, ``indices``, ``data``, ``background`` and ``diagnostics/NAME``, whose shapes
        fit each other.
    """

    place: Path
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    background_grid: tuple[int, int]
    provenance: Mapping[str, Any]
    arrays: Mapping[str, StoredArray]

    @property
    def shape(self) -> tuple[int, int]:
        """Camera samples and projector pixels (M, N)."""
        return math.prod(self.camera_shape), math.prod(self.projector_shape)


def look(path: str | Path) -> Stored:
    """Look at what a store announces.

    Raises
    ------
    InputError
        As `open`, but for what only the values of the arrays tell.
    """
    place = Path(path)
    if not place.exists():
        if place.with_name(place.name + PARTIAL).exists():
            raise InputError(
                f"{place}: the estimate is incomplete",
                hint="run the same `lightmatrix estimate` again; it goes on where it stopped",
            )
        raise InputError(f"{place}: no such file", hint="check the name")
    attributes = read_attributes(place)
    if attributes.get("format") != FORMAT:
        output = attributes.get("output")
        if isinstance(output, dict) and output.get("kind") == PACKED_CAPTURE.name:
            raise InputError(
                f"{place}: is a {PACKED_CAPTURE.name}, not a {STORE.name}",
                hint="estimate one from it: lightmatrix estimate",
            )
        raise InputError(
            f"{place}: is not a {STORE.name}", hint="give a .zarr folder from `estimate`"
        )
    if attributes.get("version") != VERSION:
        raise InputError(
            f"{place}: has format version {str(attributes.get('version'))[:20]}, this lightmatrix "
            f"reads {VERSION}",
            hint="update lightmatrix",
        )
    with damage_explained(place, RESTORE):
        return _announced(place, attributes)


def _announced(place: Path, attributes: Mapping[str, Any]) -> Stored:
    """A store whose arrays fit together, as far as they announce it."""
    camera = shape_of(attributes["camera_shape"], (2, 3), "camera_shape")
    rows, cols = shape_of(attributes["projector_shape"], (2,), "projector_shape")
    grid_rows, grid_cols = shape_of(attributes["background_grid"], (2,), "background_grid")
    samples = math.prod(camera)
    names = sorted(entry.name for entry in (place / _DIAGNOSTICS).iterdir() if entry.is_dir())
    members = [*_ARRAYS, *(f"{_DIAGNOSTICS}/{name}" for name in names)]
    arrays = {name: StoredArray.open(place / name) for name in members}
    wanted = {
        "indptr": (samples + 1,),
        "indices": arrays["data"].shape,
        "background": (samples, grid_rows * grid_cols),
        **{name: (samples,) for name in arrays if name.startswith(_DIAGNOSTICS)},
    }
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, not {shape}")
    provenance = attributes["provenance"]
    if not isinstance(provenance, dict):
        raise ValueError("its provenance is not an object")
    return Stored(place, camera, (rows, cols), (grid_rows, grid_cols), provenance, arrays)


def read_whole(stored: Stored) -> LightTransport:
    """All of a store in memory.

    Raises
    ------
    InputError
        If it does not fit, or naming what is damaged.
    """
    check_room(stored.place, sum(array.bytes for array in stored.arrays.values()))
    with damage_explained(stored.place, RESTORE):
        read = {name: array.read() for name, array in stored.arrays.items()}
        return LightTransport(
            checked_matrix(read["data"], read["indices"], read["indptr"], stored.shape),
            finite(read["background"], "background"),
            stored.camera_shape,
            stored.projector_shape,
            stored.background_grid,
            checked_diagnostics(diagnostics_of(read), stored.shape[0]),
            stored.provenance,
        )


def diagnostics_of(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """The diagnostics among the arrays of a store, by their own names."""
    prefix = f"{_DIAGNOSTICS}/"
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }
