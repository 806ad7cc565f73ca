"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from lightmatrix.errors import InputError
from lightmatrix.files.headers import parse_json
from lightmatrix.files.memory import check_room
from lightmatrix.files.npy import Header
from lightmatrix.files.reading import read_text, regular_file
from lightmatrix.outputs.kinds import PARTIAL, STORE
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.store.checked import checked_diagnostics, checked_matrix, finite, shape_of
from lightmatrix.transport.matrix import LightTransport

FORMAT, VERSION = "lightmatrix-transport", 1
_CHUNK = 1 << 20
_HEADER, _DIAGNOSTICS = "zarr.json", "diagnostics"
_ARRAYS = ("indptr", "indices", "data", "background")
# As `_write` stores arrays, and no other way is read.
_CODECS = ("bytes", "blosc", "crc32c")
# The header of a Blosc chunk: version, flags, sizes; the first of these is that of its content.
_BLOSC = struct.Struct("<4xIII")


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
            _write(group, name, values)
        diagnostics = group.create_group(_DIAGNOSTICS)
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
    if place.is_dir() and not os.path.lexists(place / _HEADER):
        raise wrong
    try:
        attributes = _attributes(_metadata(place))
    except (InputError, ValueError) as error:
        raise wrong from error
    if attributes.get("format") != FORMAT:
        raise wrong
    if attributes.get("version") != VERSION:
        raise InputError(
            f"{place}: has format version {str(attributes.get('version'))[:20]}, this lightmatrix "
            f"reads {VERSION}",
            hint="update lightmatrix",
        )
    with _damage_explained(place):
        arrays = _array_headers(place, attributes)
    check_room(place, sum(array.bytes for array in arrays.values()))
    with _damage_explained(place):
        return _read(place, attributes, arrays)


@contextmanager
def _damage_explained(place: Path) -> Iterator[None]:
    try:
        yield
    except MemoryError:
        raise
    # The codecs raise nearly anything on damaged chunks.
    except Exception as error:
        if "can't start new thread" in str(error):
            raise MemoryError(str(error)) from error
        words = " ".join(str(getattr(error, "message", error)).split())[:120]
        raise InputError(
            f"{place}: is damaged ({type(error).__name__}: {words})",
            hint="restore it, or estimate again",
        ) from error


def _shapes(attributes: dict[str, Any]) -> tuple[tuple[int, ...], tuple[int, int], tuple[int, int]]:
    """Shapes of camera, projector and background grid."""
    camera = shape_of(attributes["camera_shape"], (2, 3), "camera_shape")
    rows, cols = shape_of(attributes["projector_shape"], (2,), "projector_shape")
    grid_rows, grid_cols = shape_of(attributes["background_grid"], (2,), "background_grid")
    return camera, (rows, cols), (grid_rows, grid_cols)


def _array_headers(place: Path, attributes: dict[str, Any]) -> dict[str, Header]:
    """What the arrays of a store announce, if it fits together."""
    camera, _, grid = _shapes(attributes)
    samples = math.prod(camera)
    names = sorted(entry.name for entry in (place / _DIAGNOSTICS).iterdir() if entry.is_dir())
    arrays = {name: _array_header(place / name) for name in _ARRAYS}
    arrays |= {
        f"{_DIAGNOSTICS}/{name}": _array_header(place / _DIAGNOSTICS / name) for name in names
    }
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


def _read(place: Path, attributes: dict[str, Any], arrays: dict[str, Header]) -> LightTransport:
    camera, projector, grid = _shapes(attributes)
    provenance = attributes["provenance"]
    if not isinstance(provenance, dict):
        raise ValueError("its provenance is not an object")
    # Nothing but version 3 and no consolidated metadata: through these, other codecs come in.
    group = zarr.open_group(place, mode="r", zarr_format=3, use_consolidated=False)
    read = {name: _array(group, place, name, array) for name, array in arrays.items()}
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


def _metadata(place: Path) -> dict[str, Any]:
    """The metadata of a group or array of Zarr version 3."""
    file = place / _HEADER
    content = parse_json(read_text(file), str(file), finite=False)
    if not isinstance(content, dict) or content.get("zarr_format") != 3:
        raise ValueError(f"{file} is no metadata of Zarr 3")
    return content


def _attributes(metadata: dict[str, Any]) -> dict[str, Any]:
    attributes = metadata.get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def _array_header(place: Path) -> Header:
    """What an array announces, if it is stored as `_write` does it.

    Raises
    ------
    ValueError
        On codecs, types or chunks that we do not write: a codec may be anything, up to a program.
    """
    try:
        metadata = _metadata(place)
        codecs = tuple(codec["name"] for codec in metadata["codecs"])
        chunks = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
        shape, dtype = tuple(metadata["shape"]), np.dtype(metadata["data_type"])
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{place.name} is not an array ({error})") from error
    if codecs != _CODECS or dtype.kind not in "bfiu" or metadata.get("storage_transformers"):
        raise ValueError(f"{place.name} is stored in a way of others")
    whole = all(type(n) is int and n >= 0 for n in (*shape, *chunks))
    if not whole or len(chunks) != len(shape) or min(chunks, default=1) < 1:
        raise ValueError(f"{place.name} has a shape that no array has")
    # Of one chunk no more than the array itself, or what `_write` puts into one.
    if math.prod(chunks) > max(_CHUNK, math.prod(shape)):
        raise ValueError(f"{place.name} has chunks of {math.prod(chunks)} values")
    return Header(shape, dtype, False)


def _array(group: zarr.Group, place: Path, name: str, header: Header) -> NDArray[Any]:
    array = group[name]
    if not isinstance(array, zarr.Array) or (array.shape, array.dtype) != (
        header.shape,
        header.dtype,
    ):
        raise TypeError(f"{name} is not an array")
    # A chunk that is missing would be read as zeros.
    if array.nchunks_initialized != array.nchunks:
        raise ValueError(f"chunks of {name} are missing")
    most = math.prod(array.chunks) * header.dtype.itemsize
    for chunk in (place / name / "c").rglob("*"):
        if not chunk.is_dir():
            _check_chunk(chunk, most)
    return np.asarray(array[...])


def _check_chunk(chunk: Path, most: int) -> None:
    """Whether a chunk is a regular file that announces no more than its place in the array."""
    with regular_file(chunk).open("rb") as stream:
        header = stream.read(_BLOSC.size)
    if len(header) < _BLOSC.size or _BLOSC.unpack(header)[0] > most:
        raise ValueError(f"the chunk {chunk.name} is not what the array needs")


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
