"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import (
    CHUNK,
    HEADER,
    GrowingArray,
    StoredArray,
    as_damage_error,
    read_attributes,
)
from lightmatrix.outputs.kinds import PACKED_CAPTURE, PARTIAL, STORE
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.resources.memory import check_memory
from lightmatrix.resources.work_ahead import side_by_side
from lightmatrix.store.matrix_checks import (
    checked_diagnostics,
    checked_float32,
    checked_matrix,
    checked_shape,
)
from lightmatrix.store.seal import DIGEST, sealed, sealed_arrays
from lightmatrix.store.sparse_npz import import_npz
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

FORMAT, VERSION = "lightmatrix-transport", 1
_DIAGNOSTICS = "diagnostics"
# The arrays of the group and the types of their values.
_ARRAYS = {"indptr": np.int64, "indices": np.int32, "data": np.float32, "background": np.float32}
# The attributes that the seal covers.
_SHAPES = ("camera_shape", "projector_shape", "background_grid")
# Values of backgrounds and entries that are compressed together, eight chunks of 4 MiB. Chosen by
# hand: enough for some cores, and little memory.
_TOGETHER = 8 * CHUNK
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
    """Write a matrix as `save` does, from parts with all rows in order, one at a time in memory."""
    with atomic_folder(path, STORE, overwrite=overwrite) as part:
        group = zarr.open_group(part, mode="w", zarr_format=3)
        arrays = {name: GrowingArray(group, name, dtype) for name, dtype in _ARRAYS.items()}
        diagnostics: dict[str, GrowingArray] = {}
        inner = group.create_group(_DIAGNOSTICS)
        arrays["indptr"].add(np.zeros(1, np.int64))
        entries = 0
        for rows in _in_several_chunks(parts):
            matrix = rows.coefficients
            for name, values in rows.diagnostics.items():
                if name not in diagnostics:
                    diagnostics[name] = GrowingArray(inner, name, values.dtype)
            # Most of the time goes into compressing, which threads do side by side.
            side_by_side(
                [
                    partial(arrays["background"].add, rows.background),
                    partial(arrays["indices"].add, matrix.indices),
                    partial(arrays["data"].add, matrix.data),
                    partial(arrays["indptr"].add, entries + matrix.indptr[1:].astype(np.int64)),
                    *(partial(diagnostics[name].add, v) for name, v in rows.diagnostics.items()),
                ]
            )
            entries += int(matrix.nnz)
        side_by_side([array.close for array in (*arrays.values(), *diagnostics.values())])
        # The attributes come last, so that a group without them is recognized as incomplete.
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
        seal_store(part)


def _in_several_chunks(parts: Iterable[SparseRows]) -> Iterator[SparseRows]:
    """Parts, joined until they fill several chunks, which Zarr compresses side by side."""
    waiting: list[SparseRows] = []
    values = 0
    for part in parts:
        waiting.append(part)
        values += part.background.size + part.coefficients.nnz
        if values >= _TOGETHER:
            yield SparseRows.joined(waiting)
            waiting, values = [], 0
    if waiting:
        yield SparseRows.joined(waiting)


def seal_store(place: Path) -> None:
    """Add the seal to the attributes of a store whose arrays are written."""
    group = zarr.open_group(place, mode="r+", zarr_format=3, use_consolidated=False)
    facts = {name: group.attrs[name] for name in _SHAPES}
    group.attrs.update(sealed(place, _members(place), facts))


def open(path: str | Path) -> LightTransport:
    """Open a light transport matrix: a store (.zarr), or a file of `export` or `render` (.npz).

    All of it is checked: indices, finite values, shapes.

    Parameters
    ----------
    path : str or Path
        A store is expected unless the name ends in .npz.

    Returns
    -------
    LightTransport

    Raises
    ------
    InputError
        If there is none, it is incomplete, damaged, of a later format version, or not stored the
        way that `save` does.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("scene.zarr", lm.truth("metal").transport())
    >>> lm.open("scene.zarr")
    LightTransport(camera 64 x 64, projector 64 x 64, 1922182 entries, metal)
    """
    if Path(path).suffix.lower() == ".npz":
        return import_npz(path)
    return read_whole(read_store_header(path))


# Inode, time of the last change in nanoseconds, and size of a file.
Stamp = tuple[int, int, int]
# Nanoseconds after which a file that is written gets another time than one before it: two seconds,
# the tick of FAT; other file systems tick every 10 ms at most. Its inode may be the same.
_TICK = 2_000_000_000


def _stamp(place: Path) -> Stamp | None:
    """The stamp of a store's metadata; None if there is none."""
    try:
        facts = (place / HEADER).stat()
    except OSError:
        return None
    return facts.st_ino, facts.st_mtime_ns, facts.st_size


def _lasting_stamp(place: Path) -> Stamp | None:
    """The stamp; None if a store that is written now could get the same one."""
    stamp = _stamp(place)
    return None if stamp is None or time.time_ns() - stamp[1] < _TICK else stamp


@dataclass(eq=False)
class StoreHeader:
    """What a store announces, with its unread arrays, whose shapes fit each other."""

    place: Path
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    background_grid: tuple[int, int]
    provenance: Mapping[str, Any]
    # ``indptr``, ``indices``, ``data``, ``background`` and ``diagnostics/NAME``.
    arrays: Mapping[str, StoredArray]
    digest: str
    # What the system said of the metadata's file before it was read; None if that may not last.
    stamp: Stamp | None = None

    @contextmanager
    def unreplaced(self) -> Iterator[None]:
        """Refuse what was read within if another store has taken the place of this one."""
        try:
            yield
        except InputError as error:
            self._check_digest(error)
            raise
        self._check_digest()

    def _check_digest(self, cause: Exception | None = None) -> None:
        # The file is written anew when the columns of the store are indexed, too.
        if self.stamp is not None and _stamp(self.place) == self.stamp:
            return
        stamp = _lasting_stamp(self.place)
        if read_attributes(self.place).get(DIGEST) != self.digest:
            raise InputError(
                f"{self.place}: was replaced or removed since it was opened", hint="open it again"
            ) from cause
        # The next check need not read the file.
        self.stamp = stamp

    @property
    def shape(self) -> tuple[int, int]:
        """Camera samples and projector pixels (M, N)."""
        return math.prod(self.camera_shape), math.prod(self.projector_shape)

    @property
    def diagnostics(self) -> dict[str, StoredArray]:
        """The arrays of diagnostics by their own names."""
        prefix = f"{_DIAGNOSTICS}/"
        arrays = self.arrays.items()
        return {name.removeprefix(prefix): a for name, a in arrays if name.startswith(prefix)}


def read_store_header(path: str | Path) -> StoreHeader:
    """Read what a store announces; raises as `open` does, except for the values of the arrays."""
    place = Path(path)
    if not place.exists():
        if place.with_name(place.name + PARTIAL).exists():
            raise InputError(
                f"{place}: the estimate is incomplete",
                hint="run the same `lightmatrix estimate` again; it continues where it stopped",
            )
        raise InputError(f"{place}: no such file", hint="check the name")
    stamp = _lasting_stamp(place)
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
    # True and 1.0 equal 1, but are no versions.
    if type(attributes.get("version")) is not int or attributes["version"] != VERSION:
        raise InputError(
            f"{place}: has format version {str(attributes.get('version'))[:20]}, this lightmatrix "
            f"reads {VERSION}",
            hint="update lightmatrix",
        )
    if DIGEST not in attributes:
        raise InputError(
            f"{place}: has no digest of its chunks, which an earlier lightmatrix did not write",
            hint="run `lightmatrix estimate --overwrite` again",
        )
    with as_damage_error(place, RESTORE):
        return replace(_header(place, attributes), stamp=stamp)


def read_whole(header: StoreHeader) -> LightTransport:
    """Read all of a store into memory; an error says if it does not fit, or names the damage."""
    check_memory(header.place, sum(array.bytes for array in header.arrays.values()))
    with header.unreplaced(), as_damage_error(header.place, RESTORE):
        read = {name: array.read() for name, array in header.arrays.items()}
        diagnostics = {name: read[f"{_DIAGNOSTICS}/{name}"] for name in header.diagnostics}
        return LightTransport(
            checked_matrix(read["data"], read["indices"], read["indptr"], header.shape),
            checked_float32(read["background"], "background"),
            header.camera_shape,
            header.projector_shape,
            header.background_grid,
            checked_diagnostics(diagnostics, header.shape[0]),
            header.provenance,
        )


def _header(place: Path, attributes: Mapping[str, Any]) -> StoreHeader:
    """The header of a store, whose arrays must announce shapes that fit together."""
    camera = checked_shape(attributes["camera_shape"], (2, 3), "camera_shape")
    rows, cols = checked_shape(attributes["projector_shape"], (2,), "projector_shape")
    grid_rows, grid_cols = checked_shape(attributes["background_grid"], (2,), "background_grid")
    samples = math.prod(camera)
    facts = {name: attributes[name] for name in _SHAPES}
    arrays = sealed_arrays(place, _members(place), attributes, facts)
    for name, dtype in _ARRAYS.items():
        if arrays[name].dtype != dtype:
            raise ValueError(f"{name} holds {arrays[name].dtype}, not {np.dtype(dtype)}")
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
    grid = (grid_rows, grid_cols)
    digest = attributes[DIGEST]
    return StoreHeader(place, camera, (rows, cols), grid, provenance, arrays, digest)


def _members(place: Path) -> list[str]:
    """The names of a store's arrays."""
    names = sorted(entry.name for entry in (place / _DIAGNOSTICS).iterdir() if entry.is_dir())
    return [*_ARRAYS, *(f"{_DIAGNOSTICS}/{name}" for name in names)]
