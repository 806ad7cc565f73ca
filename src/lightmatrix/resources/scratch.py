"""Large arrays for the time of a run: in memory, or in a temporary file that has its space."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import OutputError

# Arrays up to this size are held in memory, larger ones in a temporary file.
MEMORY_BYTES = 2 << 30


def scratch_array(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array whose values are not set; above 2 GiB in a temporary file that vanishes with it.

    Parameters
    ----------
    shape : tuple of int
        Its shape.
    dtype : numpy.dtype
        Its type.

    Raises
    ------
    OutputError
        If the folder of temporary files has not enough space.
    """
    size = math.prod(shape) * dtype.itemsize
    if size <= MEMORY_BYTES:
        return np.empty(shape, dtype)
    place = tempfile.gettempdir()
    try:
        free = shutil.disk_usage(place).free
        if free < size:
            raise _too_small(place, size, f"{_gigabytes(free)} free")
        with tempfile.TemporaryFile() as file:
            # A hole in the file would kill the process when the disk is full at its first use.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:  # macOS and Windows: what was seen free above has to do.
                file.truncate(size)
            # The mapping keeps the unnamed file alive.
            return np.memmap(file, dtype, "r+", shape=shape)
    except OSError as error:
        raise _too_small(place, size, error.strerror or str(error)) from error


def _too_small(place: str, size: int, problem: str) -> OutputError:
    return OutputError(
        f"{place}: no space for {_gigabytes(size)} of temporary data ({problem})",
        hint="set TMPDIR to a folder with more space, or bin the camera's pixels",
    )


def _gigabytes(size: int) -> str:
    return f"{size / 2**30:.1f} GiB"
