"""NumPy's own files: arrays whose headers are checked before anything is read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from lightmatrix.files.reading import regular_file
from lightmatrix.resources.memory import check_room

_READ_AT_ONCE = 1 << 24


@dataclass(frozen=True)
class Header:
    """What an npy stream announces.

    Parameters
    ----------
    shape : tuple of int
        None of them negative.
    dtype : numpy.dtype
        Without objects, which would have to be unpickled.
    fortran : bool
        Whether the first index runs fastest.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool

    @property
    def bytes(self) -> int:
        """How many bytes of values follow."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_header(stream: IO[bytes]) -> Header:
    """Read the header of an npy stream; the values follow.

    Raises
    ------
    ValueError
        If it is no npy stream, or holds objects.
    """
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
    return Header(shape, dtype, fortran)


def read_values(stream: IO[bytes], header: Header) -> NDArray[Any]:
    """The array that follows a header, to the end of the stream.

    Raises
    ------
    ValueError
        If the stream is shorter or longer than the header announces.
    """
    # Filled piece by piece: a stream that ends early must not cost what it announces.
    buffer = bytearray()
    while len(buffer) < header.bytes:
        piece = stream.read(min(_READ_AT_ONCE, header.bytes - len(buffer)))
        if not piece:
            raise ValueError("it ends early")
        buffer += piece
    if stream.read(1):
        raise ValueError("it goes on after its end")
    if not header.bytes:
        return np.empty(header.shape, header.dtype)
    return np.ndarray(header.shape, header.dtype, buffer, order="F" if header.fortran else "C")


def read_npy(path: str | Path) -> NDArray[Any]:
    """Read one array.

    Raises
    ------
    InputError
        If it is no regular file, or announces more than fits into memory.
    ValueError
        If it is no npy file, is damaged, or holds Python objects.
    """
    file = regular_file(path)
    with file.open("rb") as stream:
        header = read_header(stream)
        if header.bytes != file.stat().st_size - stream.tell():
            raise ValueError("its size does not fit its header")
        check_room(file, header.bytes)
        return read_values(stream, header)


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """Float values as float32; those beyond its range become infinite, without a word of NumPy's.

    The caller looks for values that are not finite.
    """
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
