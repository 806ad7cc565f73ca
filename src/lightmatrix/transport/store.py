"""Light transport matrices on disk: one Zarr v3 group each, written whole or not at all.

The group holds the sparse part as CSR (``indptr``, ``indices``, ``data``), the ``background``, one
array per diagnostic under ``diagnostics/``, and shapes and provenance as attributes. A colour
projector has a folder with a store for each primary.
"""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import lazy_loader
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS, colour_paths, instead_of
from lightmatrix.files.kinds import (
    COLOUR_STORES,
    CORRESPONDENCE_MARK,
    PARTIAL,
    PROJECTOR_STORES,
    STORE,
)
from lightmatrix.files.reading import read_bytes
from lightmatrix.files.writing import atomic_folder
from lightmatrix.files.zarr_arrays import (
    CHUNK,
    HEADER,
    SMALL,
    StoredArray,
    as_damage_error,
    read_group,
    write_parts,
)
from lightmatrix.paths import as_path
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.stripes import is_separable
from lightmatrix.ranges import check_type
from lightmatrix.regions import Region
from lightmatrix.resources.memory import check_memory
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import ColourTransport, LightTransport
from lightmatrix.transport.npz import import_npz, read_correspondence
from lightmatrix.transport.operator import HOW_TO_GIVE, TransportOperator
from lightmatrix.transport.sparse_rows import (
    SparseRows,
    check_indptr,
    checked_float32,
    checked_matrix,
    checked_shape,
    row_blocks,
)

zarr = lazy_loader.load("zarr")

FORMAT, VERSION = "lightmatrix-transport", 1
# The arrays of the group, besides those of diagnostics/, and the types of their values.
_ARRAYS = {"indptr": np.int64, "indices": np.int32, "data": np.float32, "background": np.float32}
# The attributes that a seal covers.
_SEALED = ("camera_shape", "projector_shape", "background_grid")
_RESTORE = (
    "open it again if it was replaced; otherwise restore it from a copy, or estimate it again "
    "with overwrite=True"
)
# Entries of T in a block of rows: eight chunks, so that few chunks are read twice because a block
# ends within them.
_BLOCK_ENTRIES = 1 << 23


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
    InputError
        If its arrays were changed into what no matrix is since it was made.
    OutputError
        If it exists, ends otherwise, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("saved.zarr", lm.truth("metal").transport())
    """
    check_type("a light transport matrix", transport, LightTransport, hint=HOW_TO_GIVE)
    # Checked again, because arrays can be changed, and `open` would refuse what they hold.
    transport = replace(transport)
    rows = SparseRows(transport.sparse, transport.background, transport.diagnostics)
    shapes = transport.camera_shape, transport.projector_shape, transport.background_grid
    save_rows(path, [rows], *shapes, transport.provenance, overwrite)


def save_rows(
    path: str | Path, parts: Iterable[SparseRows], camera_shape: tuple[int, ...],
    projector_shape: tuple[int, int], background_grid: tuple[int, int],
    provenance: Mapping[str, Any], overwrite: bool,
) -> None:  # fmt: skip
    """Write a matrix as `save` does, from parts with all rows in order, one at a time in memory."""
    with atomic_folder(path, STORE, overwrite=overwrite) as part:
        shapes = {
            "camera_shape": [int(n) for n in camera_shape],
            "projector_shape": [int(n) for n in projector_shape],
            "background_grid": [int(n) for n in background_grid],
        }
        fill_store(part, _arrays(parts), shapes, provenance)


def fill_store(
    folder: Path, arrays: Iterable[Mapping[str, NDArray[Any]]], shapes: Mapping[str, Any],
    provenance: Mapping[str, Any], chunk: int | None = None, blosc: Mapping[str, Any] = SMALL,
) -> None:  # fmt: skip
    """Write a matrix into an empty folder, from parts of its arrays as `write_parts` takes them."""
    group = zarr.open_group(folder, mode="w", zarr_format=3)
    group.create_group("diagnostics")
    write_parts(group, arrays, math.prod(shapes["camera_shape"]), chunk, blosc)
    stated = json.loads(json.dumps(dict(provenance), default=str))
    group.attrs.update({"format": FORMAT, "version": VERSION, **shapes, "provenance": stated})
    seal(folder)


def _arrays(parts: Iterable[SparseRows]) -> Iterator[dict[str, NDArray[Any]]]:
    """The arrays of parts, joined until they fill eight chunks, which are compressed together."""
    waiting: list[SparseRows] = []
    entries, first = 0, np.zeros(1, np.int64)
    parts = iter(parts)
    while (part := next(parts, None)) is not None or waiting:
        if part is not None:
            waiting.append(part)
            if sum(p.background.size + p.coefficients.nnz for p in waiting) < 8 * CHUNK:
                continue
        rows, waiting = SparseRows.joined(waiting), []
        matrix = rows.coefficients
        ends = np.concatenate([first, entries + matrix.indptr[1:].astype(np.int64)])
        yield {
            "indptr": ends, "indices": np.asarray(matrix.indices, np.int32),
            "data": np.asarray(matrix.data, np.float32),
            "background": np.asarray(rows.background, np.float32),
            **{f"diagnostics/{name}": values for name, values in rows.diagnostics.items()},
        }  # fmt: skip
        entries, first = entries + int(matrix.nnz), first[:0]


def seal(place: Path) -> None:
    """Add what shows that the arrays of a group are those that were written together.

    `checksums` lists the checksums with which the chunks of each array end, so that a missing chunk
    and a sound one from elsewhere are noticed when they are read. `digest` covers these, the
    arrays' metadata and the shapes.
    """
    group = zarr.open_group(place, mode="r+", zarr_format=3, use_consolidated=False)
    members = group.members(max_depth=None)
    names = [name for name, member in members if isinstance(member, zarr.Array)]
    checksums = {name: StoredArray.open(place / name).checksums() for name in names}
    digest = _digest(place, {**group.attrs, "checksums": checksums})
    group.attrs.update({"checksums": checksums, "digest": digest})


def _digest(place: Path, attributes: Mapping[str, Any]) -> str:
    """SHA-256 of shapes and checksums as JSON, then of each array's metadata by its name."""
    facts = {name: attributes[name] for name in _SEALED}
    checksums = attributes["checksums"]
    hasher = hashlib.sha256(json.dumps([facts, checksums], sort_keys=True).encode())
    for name in sorted(checksums):
        hasher.update(read_bytes(place / name / HEADER))
    return hasher.hexdigest()


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
    if as_path(path).suffix.lower() == ".npz":
        return import_npz(path)
    return StoredTransport.open(path).load()


def open_matches(
    source: LightTransport | Correspondence | str | Path,
) -> LightTransport | Correspondence:
    """Open a store, a T.npz or a map of places; what is in memory is returned unchanged."""
    if isinstance(source, LightTransport | Correspondence):
        return source
    path = as_path(source)
    suffix, names = path.suffix.lower(), set[str]()
    if suffix == ".npz":
        # Files that cannot be read are left to the reader of T to name.
        with suppress(OSError, zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
            names = set(archive.namelist())
    if suffix in (".png", ".exr") or names & {f"{CORRESPONDENCE_MARK}.npy", "x.npy"}:
        return read_correspondence(path)
    if (path / "patterns").is_dir() and is_separable(read_patterns(path / "patterns")):
        hint = f"`lightmatrix decode {path}` finds what each camera pixel sees: give its file"
        raise InputError(f"{path}: is a capture under stripes", hint=hint)
    return open(path)


def save_colour(folder: str | Path, transport: ColourTransport, *, overwrite: bool = False) -> None:
    """Write the T of a colour projector as red.zarr, green.zarr and blue.zarr in a folder.

    Parameters
    ----------
    folder : str or Path
        The folder to make, whole or not at all.
    transport : ColourTransport
        What to write.
    overwrite : bool
        Whether an existing one may be replaced.

    Raises
    ------
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> lm.save_colour("scene", lm.ColourTransport(known, known, known))
    >>> lm.open_colour("scene").camera_shape
    (64, 64)
    """
    with atomic_folder(folder, COLOUR_STORES, overwrite=overwrite) as part:
        for name, one in zip(COLOURS, transport, strict=True):
            save(part / f"{name}.zarr", one)


def save_projectors(
    folder: str | Path, transport: LightTransport, *, overwrite: bool = False
) -> None:
    """Write T of several projectors as projector-1.zarr, projector-2.zarr, ... in a folder.

    An OutputError says that the folder exists or cannot be written.
    """
    with atomic_folder(folder, PROJECTOR_STORES, overwrite=overwrite) as part:
        for number, one in enumerate(transport.split(), start=1):
            save(part / f"projector-{number}.zarr", one)


def open_colour(folder: str | Path) -> ColourTransport:
    """Read the T of a colour projector that `save_colour` or `estimate_colour` wrote.

    Parameters
    ----------
    folder : str or Path
        Holds red.zarr, green.zarr and blue.zarr.

    Raises
    ------
    InputError
        If one of them is missing or damaged.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> lm.save_colour("saved", lm.ColourTransport(known, known, known))
    >>> lm.open_colour("saved").projector_shape
    (64, 64)
    """
    red, green, blue = (open(path) for path in colour_paths(folder))
    return ColourTransport(red, green, blue)


@dataclass(frozen=True, eq=False)
class StoredTransport(TransportOperator):
    """A light transport matrix on disk, of which as much is read as is asked for.

    Made by `open`. Blocks of rows that were read are kept, up to a gigabyte, so that a matrix that
    fits is decompressed once.

    Parameters
    ----------
    place : Path
        The store.
    camera_shape, projector_shape, background_grid, provenance
        As those of `LightTransport`.
    arrays : mapping of str to StoredArray
        ``indptr``, ``indices``, ``data``, ``background`` and ``diagnostics/NAME``, unread.
    memory : int
        Bytes of blocks that are kept.
    remedy : str
        What helps where it is damaged.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("lazy.zarr", lm.truth("metal").transport())
    >>> stored = lm.StoredTransport.open("lazy.zarr")
    >>> stored.relight(np.ones(stored.projector_shape)).shape, stored.row(20, 30).shape
    ((64, 64), (64, 64))
    >>> stored.crop((8, 0), (8, 64))
    LightTransport(camera 8 x 64, projector 64 x 64, 214586 entries, metal)
    """

    place: Path
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    background_grid: tuple[int, int]
    provenance: Mapping[str, Any]
    arrays: Mapping[str, StoredArray]
    memory: int = 1 << 30
    remedy: str = _RESTORE
    _kept: dict[int, SparseRows] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return f"StoredTransport({self.place}, {self.sizes}, {self.entries} entries)"

    @classmethod
    def open(cls, path: str | Path, *, memory: int = 1 << 30, remedy: str = _RESTORE) -> Self:
        """Open a store, reading no more than where its rows begin.

        Parameters
        ----------
        path : str or Path
            A .zarr folder from `estimate` or `save`.
        memory : int
            Bytes of blocks that are kept once they were read.
        remedy : str
            What helps where it is damaged, in messages.

        Raises
        ------
        InputError
            If there is none, it is incomplete, damaged, or of a later format version. Rows are
            checked when they are read, and a damaged chunk is named then.
        """
        place = as_path(path)
        if not place.exists():
            if place.with_name(place.name + PARTIAL).exists():
                hint = "run the same `lightmatrix estimate` again; it continues where it stopped"
                raise InputError(f"{place}: the estimate is incomplete", hint=hint)
            raise InputError(f"{place}: no such file", hint="check the name")
        hint = instead_of(place, "give a .zarr folder from `lightmatrix estimate`")
        attributes = read_group(place, STORE.name, FORMAT, VERSION, hint)
        with as_damage_error(place, remedy):
            camera = checked_shape(attributes["camera_shape"], (2, 3), "camera_shape")
            rows, cols = checked_shape(attributes["projector_shape"], (2,), "projector_shape")
            high, wide = checked_shape(attributes["background_grid"], (2,), "background_grid")
            inner = sorted(
                entry.name for entry in (place / "diagnostics").iterdir() if entry.is_dir()
            )
            diagnostics = [f"diagnostics/{name}" for name in inner]
            checksums = attributes["checksums"]
            if sorted(checksums) != sorted([*_ARRAYS, *diagnostics]):
                raise ValueError("its arrays are not those that were written together")
            arrays = {n: StoredArray.open(place / n, checksums=c) for n, c in checksums.items()}
            if attributes["digest"] != _digest(place, attributes):
                raise ValueError("its chunks or shapes are not those that were written together")
            for name, dtype in _ARRAYS.items():
                if arrays[name].dtype != dtype:
                    raise ValueError(f"{name} holds {arrays[name].dtype}, not {np.dtype(dtype)}")
            samples = math.prod(camera)
            wanted = {
                "indptr": (samples + 1,), "indices": arrays["data"].shape,
                "background": (samples, high * wide), **dict.fromkeys(diagnostics, (samples,)),
            }  # fmt: skip
            for name, shape in wanted.items():
                if arrays[name].shape != shape:
                    raise ValueError(f"{name} has shape {arrays[name].shape}, not {shape}")
            provenance = attributes["provenance"]
            if not isinstance(provenance, dict):
                raise ValueError("its provenance is not an object")
            shapes = camera, (rows, cols), (high, wide)
            matrix = cls(place, *shapes, provenance, arrays, memory, remedy)
        check_memory(place, arrays["indptr"].bytes)
        # Read now, so that damage of it is reported at once.
        assert len(matrix._indptr) > 0
        return matrix

    @property
    def entries(self) -> int:
        """Entries of the sparse part."""
        return int(self._indptr[-1])

    def rows(self, start: int, stop: int) -> SparseRows:
        """The camera samples start to stop, with diagnostics, read from their chunks alone.

        Parameters
        ----------
        start, stop : int
            0 <= start <= stop <= M.

        Raises
        ------
        InputError
            If there are no such rows, or naming a chunk that is damaged.
        """
        if not 0 <= start <= stop <= self.shape[0]:
            raise InputError(
                f"rows {start} to {stop} of a matrix of {self.shape[0]}", hint="ask for its rows"
            )
        return replace(self.some_rows(start, stop), diagnostics=self.diagnostics(start, stop))

    def sparse_rows(self, start: int, stop: int) -> csr_array:
        """Some rows without background and diagnostics, (stop - start, N) float32."""
        ends = self._indptr[start : stop + 1]
        entries = slice(int(ends[0]), int(ends[-1]))
        with as_damage_error(self.place, self.remedy):
            return checked_matrix(
                self.arrays["data"].read(entries), self.arrays["indices"].read(entries),
                ends - ends[0], (stop - start, self.shape[1]),
            )  # fmt: skip

    def some_rows(self, start: int, stop: int) -> SparseRows:
        """Rows without their diagnostics, which images do not need."""
        return SparseRows(self.sparse_rows(start, stop), self.background(start, stop))

    def background(self, start: int, stop: int) -> NDArray[np.float32]:
        """Some rows of the background, (stop - start, B) float32."""
        with as_damage_error(self.place, self.remedy):
            values = self.arrays["background"].read(slice(start, stop))
            return checked_float32(values, "background")

    def diagnostics(self, start: int, stop: int) -> dict[str, NDArray[Any]]:
        """The diagnostics of some rows by name, (stop - start,) each."""
        arrays = {name: self.arrays[name] for name in self.arrays if name not in _ARRAYS}
        with as_damage_error(self.place, self.remedy):
            values = {name: array.read(slice(start, stop)) for name, array in arrays.items()}
        return {name.removeprefix("diagnostics/"): each for name, each in values.items()}

    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        """All rows in blocks of bounded size, without diagnostics: (first row, rows)."""
        for start, stop in pairwise(row_blocks(self._indptr, _BLOCK_ENTRIES).tolist()):
            block = self._kept.get(start)
            if block is None:
                block = self.some_rows(start, stop)
                # The first blocks stay: going through all blocks in order, replacing the oldest
                # would always remove the one that is needed next.
                # A list, since other threads may add blocks meanwhile.
                if sum(map(_bytes, list(self._kept.values()))) + _bytes(block) <= self.memory:
                    self._kept[start] = block
            yield start, block

    def crop(self, corner: tuple[int, int], shape: tuple[int, int]) -> LightTransport:
        """A rectangle of the camera's pixels, of which no others are read.

        Parameters
        ----------
        corner, shape : (int, int)
            Row and column of its first pixel; its rows and columns.

        Raises
        ------
        InputError
            If it is empty or leaves the camera.
        """
        height, width, *channels = self.camera_shape
        Region(corner, shape, (height, width))  # Refuses what leaves the camera.
        depth = math.prod(channels)
        starts = (
            (row * width + corner[1]) * depth for row in range(corner[0], corner[0] + shape[0])
        )
        lines = [self.rows(start, start + shape[1] * depth) for start in starts]
        return self._in_memory(SparseRows.joined(lines), (*shape, *channels))

    def load(self) -> LightTransport:
        """All of it in memory, as `lightmatrix.open` returns it."""
        check_memory(self.place, sum(array.bytes for array in self.arrays.values()))
        return self._in_memory(self.rows(0, self.shape[0]), self.camera_shape)

    def _in_memory(self, rows: SparseRows, camera_shape: tuple[int, ...]) -> LightTransport:
        with as_damage_error(self.place, self.remedy):
            return LightTransport(
                rows.coefficients, rows.background, camera_shape, self.projector_shape,
                self.background_grid, rows.diagnostics, self.provenance,
            )  # fmt: skip

    @cached_property
    def _indptr(self) -> NDArray[np.int64]:
        with as_damage_error(self.place, self.remedy):
            indptr = self.arrays["indptr"].read()
            check_indptr(indptr, self.arrays["data"].shape[0])
        return indptr.astype(np.int64)


def _bytes(rows: SparseRows) -> int:
    matrix = rows.coefficients
    parts = (matrix.data, matrix.indices, matrix.indptr, rows.background)
    return sum(part.nbytes for part in parts)
