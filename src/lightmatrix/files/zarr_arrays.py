"""Arrays of Zarr v3: written in chunks, read in parts, and only if they are stored in our way.

A codec may be anything, even a program, so only what `create_array` writes is read back: bytes,
Blosc, a checksum. Zarr would read a missing chunk as zeros, so chunks are decoded here.
"""

import itertools
import math
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numcodecs import Blosc
from numcodecs.checksum32 import CRC32C
from numpy.typing import NDArray

from lightmatrix.errors import InputError, lacks_memory
from lightmatrix.files.kinds import printable
from lightmatrix.files.reading import check_version, parse_json, read_text, regular_file
from lightmatrix.resources.threads import side_by_side, work_ahead

if TYPE_CHECKING:
    import zarr.codecs
else:
    zarr = lazy_loader.load("zarr")

HEADER = "zarr.json"
# Values of a chunk unless the caller chooses another size.
CHUNK = 1 << 20
# SMALL takes a tenth less space than QUICK, which is decoded in a third of the time.
SMALL: Mapping[str, Any] = {"cname": "zstd", "clevel": 3, "shuffle": "shuffle"}
QUICK: Mapping[str, Any] = {"cname": "lz4hc", "clevel": 5, "shuffle": "shuffle"}
# The header of a Blosc chunk: version and flags, then three sizes, first that of its content.
_BLOSC = struct.Struct("<4xI8x")


def create_array(
    group: "zarr.Group",
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    chunks: tuple[int, ...],
    blosc: Mapping[str, Any] = SMALL,
) -> "zarr.Array[Any]":
    """Begin an array of a group; `blosc` is `QUICK` for arrays whose reading someone waits for."""
    return group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=dtype,
        # The checksum notices truncated chunks, which Blosc may take for whole ones.
        compressors=[zarr.codecs.BloscCodec(**blosc), zarr.codecs.Crc32cCodec()],
        # Chunks of zeros are written too, so that a missing chunk is noticed.
        config={"write_empty_chunks": True},
    )


def write_parts(
    group: "zarr.Group",
    parts: Iterable[Mapping[str, NDArray[Any]]],
    rows: int,
    chunk: int | None = None,
    blosc: Mapping[str, Any] = SMALL,
) -> None:
    """Write arrays of unknown lengths from parts that follow each other along the first axis.

    Each part holds values of all arrays, by name; most arrays have `rows` rows in the end. A chunk
    has at most `chunk` values (None: CHUNK).
    """
    arrays: dict[str, zarr.Array[Any]] = {}
    for part in parts:
        for name, values in part.items():
            if name not in arrays:
                wide = tuple(max(1, n) for n in values.shape[1:])
                most = max(1, (chunk or CHUNK) // math.prod(wide))
                chunks = (min(most, max(rows, len(values))), *wide)
                shape = (0, *values.shape[1:])
                arrays[name] = create_array(group, name, shape, values.dtype, chunks, blosc)
        # Most of the time goes into compressing, which threads do side by side.
        side_by_side([partial(arrays[name].append, part[name]) for name in part if len(part[name])])


def _read_metadata(place: Path) -> dict[str, Any]:
    """The metadata of a group or array of Zarr version 3, or InputError or ValueError."""
    file = place / HEADER
    content = parse_json(read_text(file), str(file), finite=False)
    if not isinstance(content, dict) or content.get("zarr_format") != 3:
        raise ValueError(f"{file} is no metadata of Zarr 3")
    return content


def read_group(place: Path, kind: str, form: str, version: int, hint: str) -> dict[str, Any]:
    """The attributes of a group of ours; an InputError if it has another format or version."""
    attributes: Any = {}
    if place.is_dir() and os.path.lexists(place / HEADER):
        try:
            attributes = _read_metadata(place).get("attributes")
        except (InputError, ValueError):
            if not os.access(place / HEADER, os.R_OK):
                raise
    attributes = attributes if isinstance(attributes, dict) else {}
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
        if lacks_memory(error):
            raise MemoryError(str(error)) from error
        words = " ".join(str(getattr(error, "message", error)).split())[:120]
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
    ) -> "StoredArray":
        """Read the header of an array; a ValueError says if we would not store it this way.

        A chunk may hold `most_chunk` values, even if the array has fewer. A chunk with another
        checksum than in `checksums` is refused, so that one from elsewhere is noticed.
        """
        metadata = _read_metadata(place)
        try:
            codecs = [codec["name"] for codec in metadata["codecs"]]
            endian = metadata["codecs"][0].get("configuration", {}).get("endian", "little")
            chunks = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            shape, dtype = tuple(metadata["shape"]), np.dtype(metadata["data_type"])
            keys = metadata["chunk_key_encoding"]
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise ValueError(f"{place.name} is not an array ({error})") from error
        ours = codecs == ["bytes", "blosc", "crc32c"] and dtype.kind in "bfiu"
        ours &= endian == "little"
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

    @property
    def bytes(self) -> int:
        """The size of all its values."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self, *where: slice) -> NDArray[Any]:
        """The values of a box; a ValueError names a chunk that is missing or damaged."""
        box = (*where, *(slice(None) for _ in self.shape[len(where) :]))
        spans = [range(*part.indices(size)[:2]) for part, size in zip(box, self.shape, strict=True)]
        values = np.empty([len(span) for span in spans], self.dtype)

        def fill(index: tuple[int, ...]) -> None:
            into, part = [], []
            for number, size, span in zip(index, self.chunks, spans, strict=True):
                first = number * size
                low, high = max(first, span.start), min(first + size, span.stop)
                into.append(slice(low - span.start, high - span.start))
                part.append(slice(low - first, high - first))
            values[tuple(into)] = self._chunk(index)[tuple(part)]

        grid = [
            range(span.start // size, -(-span.stop // size)) if span else ()
            for span, size in zip(spans, self.chunks, strict=True)
        ]
        for _ in work_ahead(fill, list(itertools.product(*grid))):
            pass
        return values

    def checksums(self) -> str:
        """The checksums with which its chunks end, in order, eight hexadecimal digits each."""
        indices = itertools.product(*map(range, self._grid))
        return "".join(self.chunk_file(index).read_bytes()[-4:].hex() for index in indices)

    def chunk_file(self, index: tuple[int, ...]) -> Path:
        """The file of a chunk, by its number along each axis."""
        return self.place.joinpath("c", *map(str, index))

    def _chunk(self, index: tuple[int, ...]) -> NDArray[Any]:
        """The values of a chunk, whose file must be a regular one that announces no more."""
        file = self.chunk_file(index)
        name = str(file.relative_to(self.place.parent))
        if not os.path.lexists(file):
            raise ValueError(f"the chunk {name} is missing")
        content = regular_file(file).read_bytes()
        most = math.prod(self.chunks) * self.dtype.itemsize
        if len(content) < _BLOSC.size or _BLOSC.unpack_from(content)[0] != most:
            raise ValueError(f"the chunk {name} is not what the array needs")
        if self.expected is not None:
            first = 8 * int(np.ravel_multi_index(index, self._grid))
            if content[-4:].hex() != self.expected[first : first + 8]:
                raise ValueError(f"the chunk {name} is not the one that was written")
        try:
            decoded = Blosc().decode(CRC32C(location="end").decode(content))
            return np.frombuffer(decoded, self.dtype).reshape(self.chunks)
        except (ValueError, RuntimeError) as error:
            words = " ".join(str(error).split())[:80]
            raise ValueError(f"the chunk {name}: {words}") from error

    @property
    def _grid(self) -> tuple[int, ...]:
        """Chunks along each axis."""
        return tuple(-(-n // chunk) for n, chunk in zip(self.shape, self.chunks, strict=True))
