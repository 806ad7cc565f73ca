"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from scipy.sparse import csr_array
from zarr.codecs import BloscCodec, Crc32cCodec

from lightmatrix.errors import InputError
from lightmatrix.files.outputs import atomic_folder, check_output
from lightmatrix.transport.matrix import LightTransport

FORMAT, VERSION = "lightmatrix-transport", 1
SUFFIX = ".zarr"
# Beside an output, its running results (see `lightmatrix.store.checkpoint`).
PARTIAL = ".partial"
_CHUNK = 1 << 20


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
    check_output(path, overwrite=overwrite, suffixes=(SUFFIX,))
    with atomic_folder(path, overwrite=overwrite) as part:
        group = zarr.open_group(part, mode="w", zarr_format=3)
        sparse = transport.sparse
        arrays: dict[str, NDArray[Any]] = {
            "indptr": np.asarray(sparse.indptr, np.int64),
            "indices": np.asarray(sparse.indices, np.int32),
            "data": np.asarray(sparse.data, np.float32),
            "background": np.asarray(transport.background, np.float32),
        }
        for name, values in arrays.items():
            _write(group, name, values)
        diagnostics = group.create_group("diagnostics")
        for name, values in transport.diagnostics.items():
            _write(diagnostics, name, values)
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
        If there is none, it is incomplete, damaged, or of a later format version.
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
    if not (place / "zarr.json").is_file():
        raise wrong
    try:
        group = zarr.open_group(place, mode="r")
        attributes: dict[str, Any] = dict(group.attrs)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise wrong from error
    if attributes.get("format") != FORMAT:
        raise wrong
    if attributes.get("version") != VERSION:
        raise InputError(
            f"{place}: has format version {attributes.get('version')}, this lightmatrix reads "
            f"{VERSION}",
            hint="update lightmatrix",
        )
    try:
        return _read(group, attributes)
    # The codecs raise nearly anything on damaged chunks.
    except Exception as error:
        raise InputError(
            f"{place}: is damaged ({type(error).__name__}: {str(error)[:120]})",
            hint="restore it, or estimate again",
        ) from error


def _read(group: zarr.Group, attributes: dict[str, Any]) -> LightTransport:
    camera = tuple(int(n) for n in attributes["camera_shape"])
    rows, cols = (int(n) for n in attributes["projector_shape"])
    grid_rows, grid_cols = (int(n) for n in attributes["background_grid"])
    parts = tuple(_array(group, name) for name in ("data", "indices", "indptr"))
    sparse = csr_array(parts, shape=(int(np.prod(camera)), rows * cols))
    diagnostics = group["diagnostics"]
    if not isinstance(diagnostics, zarr.Group):
        raise TypeError("diagnostics is not a group")
    return LightTransport(
        sparse,
        _array(group, "background"),
        camera,
        (rows, cols),
        (grid_rows, grid_cols),
        {name: _array(diagnostics, name) for name in sorted(diagnostics.array_keys())},
        attributes["provenance"],
    )


def _array(group: zarr.Group, name: str) -> NDArray[Any]:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise TypeError(f"{name} is not an array")
    # A chunk that is missing would be read as zeros.
    if array.nchunks_initialized != array.nchunks:
        raise ValueError(f"chunks of {name} are missing")
    return np.asarray(array[...])


def _write(group: zarr.Group, name: str, values: NDArray[Any]) -> None:
    width = int(np.prod(values.shape[1:]))
    rows = max(1, min(len(values), _CHUNK // max(1, width)))
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=(rows, *values.shape[1:]),
        dtype=values.dtype,
        # The checksum because Blosc may take a truncated chunk for a whole one.
        compressors=[BloscCodec(cname="zstd", clevel=5, shuffle="shuffle"), Crc32cCodec()],
        # Chunks of zeros are written too, so that a missing chunk is known to be missing.
        config={"write_empty_chunks": True},
    )
    array[...] = values
