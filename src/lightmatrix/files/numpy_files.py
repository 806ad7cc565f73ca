"""NumPy's files (npy, npz), which hold no Python objects and must fit into memory."""

import math
import zipfile
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.reading import regular_file
from lightmatrix.resources.memory import check_memory

# NumPy parses headers as Python literals, which two threads must not do at once: until 3.11.7,
# Python may raise a SystemError then, where its garbage collector calls Python code (gh-106905).
_HEADERS = Lock()


def map_npy(path: str | Path) -> NDArray[Any]:
    """The array of an npy file, of which only what is used is read; ValueError if it is damaged."""
    with _HEADERS:
        mapped: NDArray[Any] = np.lib.format.open_memmap(regular_file(path), mode="r")
    return mapped


def read_npy(path: str | Path) -> NDArray[Any]:
    """Read an npy file; a ValueError says what is damaged."""
    mapped = map_npy(path)
    check_memory(Path(path), mapped.nbytes)
    return np.array(mapped)


def read_npz(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz file, and verify the checksums of the archive."""
    file, size = regular_file(path), 0
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(member.file_size for member in archive.infolist())
            check_memory(file, size)
        with _HEADERS, np.load(file, allow_pickle=False) as opened:
            arrays = dict(opened)
        # NumPy returns the bytes of members that are no arrays.
        if other := [name for name, values in arrays.items() if isinstance(values, bytes)]:
            raise ValueError(f"{other[0][:40]!r} is no array")
    except InputError:
        raise
    # Damaged archives raise nearly anything, among them NotImplementedError and zlib.error.
    except Exception as error:
        # Only a damaged archive claims arrays that are larger than its members.
        if isinstance(error, MemoryError) and math.prod(getattr(error, "shape", ())) <= size:
            raise
        raise InputError(
            f"{file}: cannot be read as npz ({' '.join(str(error).split())[:120]})",
            hint="give a file from `lightmatrix export` or `render`, or write it again",
        ) from error
    return arrays


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """Float values as float32; values beyond its range become infinite, without a warning."""
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
