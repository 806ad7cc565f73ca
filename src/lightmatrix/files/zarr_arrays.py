"""Arrays of Zarr v3: written in chunks, read in parts, and only if they are stored in our way.

A codec may be anything, even a program, so only what `create_array` writes is read back: bytes,
Blosc, a checksum. Zarr compares the checksums, and reads a missing chunk as zeros: so every chunk
is looked at before it is decoded. An array may be read with the list of its chunks' checksums, and
then a sound chunk from elsewhere is noticed as well.
"""

from __future__ import annotations

import itertools
import math
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import printable
from lightmatrix.files.reading import check_version, parse_json, read_text, regular_file
from lightmatrix.resources.threads import side_by_side

HEADER = "zarr.json"
# Values of a chunk unless the caller chooses another size.
CHUNK = 1 << 20
# SMALL takes a tenth less space than QUICK, which is decoded in a third of the time.
SMALL = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
QUICK = BloscCodec(cname="lz4hc", clevel=5, shuffle="shuffle")
# The header of a Blosc chunk: version and flags, then three sizes, first that of its content.
_BLOSC = struct.Struct("<4xIII")
# Python's words where there is no memory left for a thread, which is no damage.
_NO_THREAD = "can't start new thread"


def create_array(
    group: zarr.Group,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    chunks: tuple[int, ...],
    blosc: BloscCodec = SMALL,
) -> zarr.Array[Any]:
    """Begin an array of a group; `blosc` is `QUICK` for arrays whose reading someone waits for."""
    return group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=dtype,
        # The checksum notices truncated chunks, which Blosc may take for whole ones.
        compressors=[blosc, Crc32cCodec()],
        # Chunks of zeros are written too, so that a missing chunk is noticed.
        config={"write_empty_chunks": True},
    )


def write_parts(
    group: zarr.Group,
    parts: Iterable[Mapping[str, NDArray[Any]]],
    chunk: int | None = None,
    blosc: BloscCodec = SMALL,
) -> None:
    """Write arrays of unknown lengths from parts that follow each other along the first axis.

    Each part holds values of all arrays, by name. A chunk has about `chunk` values (None: CHUNK).
    """
    arrays: dict[str, _GrowingArray] = {}
    for part in parts:
        for name in set(part) - set(arrays):
            arrays[name] = _GrowingArray(group, name, chunk or CHUNK, blosc)
        # Most of the time goes into compressing, which threads do side by side.
        side_by_side([partial(arrays[name].add, values) for name, values in part.items()])
    side_by_side([array.close for array in arrays.values()])


class _GrowingArray:
    """An array of unknown length, written in chunks of about `values` values as they fill."""

    def __init__(self, group: zarr.Group, name: str, values: int, blosc: BloscCodec) -> None:
        self._group, self._name, self._values, self._blosc = group, name, values, blosc
        self._waiting: list[NDArray[Any]] = []
        self._array: zarr.Array[Any] | None = None

    def add(self, values: NDArray[Any]) -> None:
        """Append values along the first axis."""
        self._waiting.append(values)
        chunk = max(1, self._values // max(1, int(np.prod(values.shape[1:]))))
        if sum(map(len, self._waiting)) >= chunk:
            self._write(chunk, last=False)

    def close(self) -> None:
        """Write the rest; something must have been added, even if only an empty array."""
        self._write(max(1, sum(map(len, self._waiting))), last=True)

    def _write(self, chunk: int, *, last: bool) -> None:
        values = np.concatenate(self._waiting)
        ready = len(values) if last else len(values) // chunk * chunk
        shape = values.shape[1:]
        if self._array is None:
            chunks = (chunk, *(max(1, n) for n in shape))
            self._array = create_array(
                self._group, self._name, (0, *shape), values.dtype, chunks, self._blosc
            )
        if ready:
            self._array.append(values[:ready])
        self._waiting = [values[ready:]]


def _read_metadata(place: Path) -> dict[str, Any]:
    """The metadata of a group or array of Zarr version 3, or InputError or ValueError."""
    file = place / HEADER
    content = parse_json(read_text(file), str(file), finite=False)
    if not isinstance(content, dict) or content.get("zarr_format") != 3:
        raise ValueError(f"{file} is no metadata of Zarr 3")
    return content


def read_attributes(place: Path) -> dict[str, Any]:
    """The attributes of a group; empty if there is no group that can be read."""
    if not place.is_dir() or not os.path.lexists(place / HEADER):
        return {}
    try:
        attributes = _read_metadata(place).get("attributes")
    except (InputError, ValueError):
        if not os.access(place / HEADER, os.R_OK):
            raise
        return {}
    return attributes if isinstance(attributes, dict) else {}


def read_group(place: Path, kind: str, form: str, version: int, hint: str) -> dict[str, Any]:
    """The attributes of a group of ours; an InputError if it has another format or version."""
    attributes = read_attributes(place)
    if attributes.get("format") != form:
        output = attributes.get("output")
        other = output.get("kind") if isinstance(output, dict) else None
        words = f"not a {kind}"
        if isinstance(other, str) and other != kind:
            words = f"a {printable(other)[:40]}, {words}"
        raise InputError(f"{place}: is {words}", hint=hint)
    check_version(place, attributes.get("version"), version)
    return attributes


@contextmanager
def as_damage_error(place: Path, hint: str) -> Iterator[None]:
    """Turn whatever goes wrong within into an InputError: the folder is damaged, and what to do."""
    try:
        yield
    except MemoryError:
        raise
    except PermissionError as error:
        raise InputError(
            f"{error.filename or place}: cannot be read ({error.strerror})",
            hint="check its permissions",
        ) from error
    # Codecs raise nearly anything on damaged chunks.
    except Exception as error:
        if isinstance(error.__cause__, PermissionError):
            raise
        if _NO_THREAD in str(error):
            raise MemoryError(str(error)) from error
        words = " ".join(str(getattr(error, "message", error)).split())[:120]
        # Wrong settings of zarr-python look like damage.
        settings = sorted(name for name in os.environ if name.startswith("ZARR_"))
        if settings:
            hint = f"unset {' and '.join(settings)} and try again; if that does not help, {hint}"
        raise InputError(
            f"{place}: is damaged ({type(error).__name__}: {words})", hint=hint
        ) from error


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array on disk, of which only the requested parts are read; made by `open`."""

    place: Path
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    # The checksums of its chunks, as `checksums` returns them, if they are known.
    expected: str | None = None

    @classmethod
    def open(
        cls, place: Path, most_chunk: int = CHUNK, *, checksums: str | None = None
    ) -> StoredArray:
        """Read the header of an array; a ValueError says if we would not store it this way.

        A chunk may hold `most_chunk` values, even if the array has fewer. `checksums` are those of
        its chunks, as `checksums` returns them; a chunk with another one is refused.
        """
        metadata = _read_metadata(place)
        try:
            codecs = [codec["name"] for codec in metadata["codecs"]]
            chunks = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            shape, dtype = tuple(metadata["shape"]), np.dtype(metadata["data_type"])
            keys = metadata["chunk_key_encoding"]
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{place.name} is not an array ({error})") from error
        ours = codecs == ["bytes", "blosc", "crc32c"] and dtype.kind in "bfiu"
        ours &= keys == {"name": "default", "configuration": {"separator": "/"}}
        if not ours or metadata.get("storage_transformers"):
            raise ValueError(f"{place.name} is stored in another way than ours")
        whole = all(type(n) is int and n >= 0 for n in (*shape, *chunks))
        if not whole or len(chunks) != len(shape) or min(chunks, default=1) < 1:
            raise ValueError(f"{place.name} has a shape that no array has")
        # A chunk may hold no more values than the whole array, or than our chunks do.
        if math.prod(chunks) > max(most_chunk, math.prod(shape)):
            raise ValueError(f"{place.name} has chunks of {math.prod(chunks)} values")
        made = cls(place, shape, chunks, dtype, checksums)
        if checksums is not None and (
            type(checksums) is not str or len(checksums) != 8 * math.prod(made._grid)
        ):
            raise ValueError(f"{place.name} has not as many chunks as were written")
        return made

    @cached_property
    def _array(self) -> zarr.Array[Any]:
        # Only version 3 is opened: other versions permit other codecs.
        array = zarr.open_array(self.place, mode="r", zarr_format=3)
        if (array.shape, array.chunks, array.dtype) != (self.shape, self.chunks, self.dtype):
            raise ValueError(f"{self.place.name} is not an array, or was replaced meanwhile")
        return array

    @property
    def bytes(self) -> int:
        """The size of all its values."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self, *where: slice) -> NDArray[Any]:
        """The values of a box; a ValueError names a chunk that is missing or damaged."""
        box = (*where, *(slice(None) for _ in self.shape[len(where) :]))
        spans = [slice(*part.indices(size)[:2]) for part, size in zip(box, self.shape, strict=True)]
        grid = [
            range(span.start // chunk, -(-span.stop // chunk)) if span.stop > span.start else []
            for span, chunk in zip(spans, self.chunks, strict=True)
        ]
        indices = list(itertools.product(*grid))
        for index in indices:
            self._check_chunk(index)
        try:
            values = np.asarray(self._array[tuple(spans)])
        except MemoryError:
            raise
        except Exception as error:
            if _NO_THREAD in str(error):
                raise
            # Each chunk is read by itself, to name the one that is damaged.
            for index in indices:
                cuts = zip(index, self.chunks, strict=True)
                try:
                    self._array[tuple(slice(i * chunk, (i + 1) * chunk) for i, chunk in cuts)]
                except Exception:
                    words = " ".join(str(error).split())[:80]
                    raise ValueError(f"the chunk {self._named(index)}: {words}") from error
            raise ValueError(f"{self.place.name} cannot be read ({error})") from error
        # Compared after the reading, so that an array that was replaced meanwhile is noticed, too.
        for index in indices if self.expected else ():
            first = 8 * int(np.ravel_multi_index(index, self._grid))
            if _checksum(self.chunk_file(index)) != str(self.expected)[first : first + 8]:
                raise ValueError(f"the chunk {self._named(index)} is not the one that was written")
        return values

    def checksums(self) -> str:
        """The checksums of its chunks in their order, eight hexadecimal digits each."""
        parts = []
        for index in itertools.product(*map(range, self._grid)):
            self._check_chunk(index)
            parts.append(_checksum(self.chunk_file(index)))
        return "".join(parts)

    def chunk_file(self, index: tuple[int, ...]) -> Path:
        """The file of a chunk, by its number along each axis."""
        return self.place.joinpath("c", *map(str, index))

    def _check_chunk(self, index: tuple[int, ...]) -> None:
        """Check that a chunk is a regular file that announces no more values than a chunk has."""
        file = self.chunk_file(index)
        # Zarr would read a missing chunk as zeros.
        if not os.path.lexists(file):
            raise ValueError(f"the chunk {self._named(index)} is missing")
        with regular_file(file).open("rb") as stream:
            header = stream.read(_BLOSC.size)
        most = math.prod(self.chunks) * self.dtype.itemsize
        if len(header) < _BLOSC.size or _BLOSC.unpack(header)[0] > most:
            raise ValueError(f"the chunk {self._named(index)} is not what the array needs")

    @property
    def _grid(self) -> tuple[int, ...]:
        """Chunks along each axis."""
        return tuple(-(-n // chunk) for n, chunk in zip(self.shape, self.chunks, strict=True))

    def _named(self, index: tuple[int, ...]) -> str:
        return str(self.chunk_file(index).relative_to(self.place.parent))


def _checksum(file: Path) -> str:
    """The checksum with which a chunk ends, in hexadecimal digits."""
    with file.open("rb") as stream:
        stream.seek(-4, os.SEEK_END)
        return stream.read().hex()
