"""Disk space: checked before outputs are computed, and reserved for large temporary arrays."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import OutputError
from lightmatrix.reprs import amount

# Arrays of up to 2 GiB are held in memory, larger ones in a temporary file. Chosen by hand: less
# writes the samples of ordinary captures to disk, more leaves small machines no memory to solve in.
SCRATCH_MEMORY_BYTES = 2 << 30


def check_disk_space(folder: Path, needed: int, output: str | Path, words: str = "up to") -> None:
    """Refuse an output of more bytes than its disk has free; `words`: "up to" or "at least"."""
    place = next(part for part in (folder, *folder.parents) if os.path.lexists(part))
    try:
        free = shutil.disk_usage(place).free
    except OSError:
        # A file system that does not say how much is free fails when it is full.
        return
    if needed > free:
        raise OutputError(
            f"{output}: takes {words} {amount(needed)}, {amount(free)} are free",
            hint="free some space, or choose a folder on another disk",
        )


def scratch_array(
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    memory: int | None = None,
    folder: Path | None = None,
) -> NDArray[Any]:
    """An array without values; if large, in a temporary file that vanishes with it.

    `memory` are the bytes from which on it is large (None: 2 GiB). The file is in `folder` (None:
    the one for temporary files).
    """
    size = math.prod(shape) * dtype.itemsize
    if size <= (SCRATCH_MEMORY_BYTES if memory is None else memory):
        return np.empty(shape, dtype)
    place = str(folder or tempfile.gettempdir())
    try:
        free = shutil.disk_usage(place).free
        if free < size:
            raise OSError(f"{amount(free)} are free")
        with tempfile.TemporaryFile(dir=place) as file:
            # A hole in the file would kill the process when the disk is full at its first use.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:  # macOS and Windows cannot reserve space; the check above must do.
                file.truncate(size)
            # The mapping keeps the unnamed file alive.
            return np.memmap(file, dtype, "r+", shape=shape)
    except OSError as error:
        other = "choose a folder on another disk" if folder else "set TMPDIR to a larger disk"
        raise OutputError(
            f"{place}: no space for {amount(size)} of temporary data ({error.strerror or error})",
            hint=f"{other}, or bin the camera's pixels",
        ) from error
