"""Free memory, on this machine and within the limits of a container, and free disk space."""

import math
import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from lightmatrix.errors import InputError, OutputError
from lightmatrix.reprs import amount

# Bytes of each unit, by its name in lower case.
UNITS = {"mb": 10**6, "gb": 10**9, "tb": 10**12, "mib": 2**20, "gib": 2**30, "tib": 2**40}
# Linux lists the control groups of this process in the first file. The second folder holds all
# groups. A container often sees its own group as the root there, whatever the first file says.
_OWN_GROUPS, _ALL_GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def available_bytes() -> int:
    """Memory that is free without swapping, on this machine and within limits of a container."""
    free = int(psutil.virtual_memory().available)
    left = bytes_left_by_groups()
    return free if left is None else min(free, left)


def memory_bytes(text: str) -> int:
    """Parse an amount of memory such as 4GiB, 800MB or 2.5 GiB."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([A-Za-z]+)\s*", text, flags=re.ASCII)
    unit = UNITS.get(match[2].lower()) if match else None
    amount = float(match[1]) * unit if match and unit else math.inf
    if math.isinf(amount):
        hint = "write one such as 4GiB or 800MB"
        raise InputError(f"an amount of memory of {text!r:.100}", hint=hint)
    return int(amount)


def check_memory(what: Path | str, needed: float, hint: str | None = None) -> None:
    """Refuse what exceeds the free memory, such as a file by its content before it is read."""
    if needed > (free := available_bytes()):
        subject = f"{what}:" if isinstance(what, Path) else what
        raise InputError(
            f"{subject} takes {amount(needed)} of memory, {amount(free)} are free",
            hint=hint or "if the file is intact, read it on a machine with more memory",
        )


def bytes_left_by_groups() -> int | None:
    """Bytes that the tightest Linux control group around this process leaves it.

    Cached files count as free, because the kernel drops them first. None where nothing is limited
    or there are no such groups.
    """
    try:
        lines = _OWN_GROUPS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    left = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:  # Version 2 of control groups, then version 1.
            place, names = _ALL_GROUPS, ("memory.max", "memory.current", "")
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_")
            place = _ALL_GROUPS / "memory"
        else:
            continue
        own = Path(path.lstrip("/"))
        groups = [_bytes_left(place / group, *names) for group in (own, *own.parents)]
        left += [size for size in groups if size is not None]
    return min(left, default=None)


def _bytes_left(group: Path, limit: str, used: str, prefix: str) -> int | None:
    """What one group leaves; None if it does not say, or has no limit."""
    try:
        # Version 2 writes "max" where there is no limit, which is no number either.
        most, now = (int((group / name).read_text()) for name in (limit, used))
        sizes = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
        cached = sum(int(sizes[f"{prefix}{kind}_file"]) for kind in ("inactive", "active"))
    except (OSError, ValueError, KeyError):
        return None
    return max(0, most - max(0, now - cached))


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


def scratch_array(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array without values; if large, in a temporary file that vanishes with it."""
    size = math.prod(shape) * dtype.itemsize
    if size <= SCRATCH_MEMORY_BYTES:
        return np.empty(shape, dtype)
    place = tempfile.gettempdir()
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
        raise OutputError(
            f"{place}: no space for {amount(size)} of temporary data ({error.strerror or error})",
            hint="set TMPDIR to a larger disk, or bin the camera's pixels",
        ) from error
