"""NumPy's files (npy, npz): headers are checked before any values are read or inflated."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.reading import regular_file
from lightmatrix.resources.memory import check_memory

# The compressions that `numpy.savez` and `savez_compressed` write.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_SUFFIX = ".npy"


@dataclass(frozen=True)
class NpyHeader:
    """What an npy stream announces: a valid shape, a type without objects, the order of values."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool

    @property
    def bytes(self) -> int:
        """How many bytes of values follow."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(stream: IO[bytes]) -> NpyHeader:
    """Read the header of an npy stream; the values follow. A ValueError says what is wrong."""
    version = npy_format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = npy_format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = npy_format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"npy version {version[0]}.{version[1]}")
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    if dtype.itemsize == 0 or any(type(n) is not int or n < 0 for n in shape):
        raise ValueError("a shape or type that no array has")
    return NpyHeader(shape, dtype, fortran)


def read_npy(path: str | Path) -> NDArray[Any]:
    """Read an npy file; a ValueError says what is damaged."""
    file = regular_file(path)
    with file.open("rb") as stream:
        header = read_npy_header(stream)
        if header.bytes != file.stat().st_size - stream.tell():
            raise ValueError("its size does not fit its header")
        check_memory(file, header.bytes)
        return _read_values(stream, header)


def read_npz(
    path: str | Path, check: Callable[[Mapping[str, NpyHeader]], None] | None = None
) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz file, and verify the checksums of the archive.

    `check` gets the headers by name before any array is read, and may refuse them by a ValueError:
    some arrays determine how large others are.
    """
    file = regular_file(path)
    try:
        with zipfile.ZipFile(file) as archive:
            members = _members(archive)
            headers = {name: _member_header(archive, member) for name, member in members.items()}
            if check is not None:
                check(headers)
            check_memory(file, sum(header.bytes for header in headers.values()))
            arrays = {}
            for name, member in members.items():
                with archive.open(member) as stream:
                    arrays[name] = _read_values(stream, read_npy_header(stream))
            return arrays
    except (InputError, MemoryError):
        raise
    # Damaged archives raise nearly anything, among them NotImplementedError and zlib.error.
    except Exception as error:
        raise InputError(
            f"{file}: cannot be read as npz ({' '.join(str(error).split())[:120]})",
            hint="give a file from `lightmatrix export` or `render`, or write it again",
        ) from error


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """Float values as float32; values beyond its range become infinite, without a warning."""
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)


def _read_values(stream: IO[bytes], header: NpyHeader) -> NDArray[Any]:
    """The array that follows a header and ends with the stream."""
    # Filled in pieces of 16 MiB: a stream that ends early must not cost what it announces.
    buffer = bytearray()
    while len(buffer) < header.bytes:
        piece = stream.read(min(1 << 24, header.bytes - len(buffer)))
        if not piece:
            raise ValueError("it ends early")
        buffer += piece
    if stream.read(1):
        raise ValueError("it continues after its end")
    if not header.bytes:
        return np.empty(header.shape, header.dtype)
    return np.ndarray(header.shape, header.dtype, buffer, order="F" if header.fortran else "C")


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    # Far more than any of ours has; each costs a header to be read.
    if len(entries) > 1000:
        raise ValueError(f"an archive of {len(entries)} members")
    members = {}
    for entry in entries:
        name = entry.filename.removesuffix(_SUFFIX)
        if name == entry.filename or entry.compress_type not in _METHODS or entry.flag_bits & 1:
            raise ValueError("a member that NumPy has not written")
        if name in members:
            raise ValueError(f"{name[:40]!r} appears twice")
        members[name] = entry
    return members


def _member_header(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NpyHeader:
    with archive.open(member) as stream:
        header = read_npy_header(stream)
        if header.bytes != member.file_size - stream.tell():
            raise ValueError(f"the size of {member.filename[:40]!r} does not fit its header")
        return header
