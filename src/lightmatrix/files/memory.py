"""The memory that is free, asked before anything is made that a file only announces."""

from __future__ import annotations

from pathlib import Path

import psutil

from lightmatrix.errors import InputError
from lightmatrix.files.cgroups import memory_left


def available_bytes() -> int:
    """Memory that is free without swapping, on this machine and within limits of a container."""
    free = int(psutil.virtual_memory().available)
    left = memory_left()
    return free if left is None else min(free, left)


def check_room(file: Path, needed: int) -> None:
    """Refuse to read what would not fit into memory.

    A compressed file of a few megabytes may announce, and even hold, terabytes.

    Parameters
    ----------
    file : Path
        What is read.
    needed : int
        Bytes that its content takes in memory.

    Raises
    ------
    InputError
        If they are not free.
    """
    available = available_bytes()
    if needed > available:
        raise InputError(
            f"{file}: announces {needed / 2**30:.3g} GiB of data, {available / 2**30:.3g} GiB of "
            "memory are free",
            hint="if the file is what it should be, read it on a machine with more memory",
        )
