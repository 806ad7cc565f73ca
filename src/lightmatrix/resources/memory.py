"""The memory that is free, asked before anything is made that a file only announces."""

from __future__ import annotations

import re
from pathlib import Path

import psutil

from lightmatrix.errors import InputError
from lightmatrix.resources.cgroups import memory_left

# Bytes of what amounts of memory are written in.
UNITS = {"mb": 10**6, "gb": 10**9, "tb": 10**12, "mib": 2**20, "gib": 2**30, "tib": 2**40}


def available_bytes() -> int:
    """Memory that is free without swapping, on this machine and within limits of a container."""
    free = int(psutil.virtual_memory().available)
    left = memory_left()
    return free if left is None else min(free, left)


def memory_bytes(text: str) -> int:
    """Read an amount of memory such as 4GiB, 800MB or 2.5 GiB.

    Raises
    ------
    InputError
        On anything else.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([A-Za-z]+)\s*", text, flags=re.ASCII)
    unit = UNITS.get(found[2].lower()) if found else None
    if found is None or unit is None:
        raise InputError(f"an amount of memory of {text!r}", hint="write one such as 4GiB or 800MB")
    return int(float(found[1]) * unit)


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
