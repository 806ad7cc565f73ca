"""The room on a disk, asked before anything is computed or written that would not fit."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from lightmatrix.errors import OutputError


def check_disk(folder: Path, needed: int, output: str | Path, words: str = "up to") -> None:
    """Refuse an output that the disk cannot hold.

    Parameters
    ----------
    folder : Path
        Where it will lie; the nearest folder above it that exists is asked.
    needed : int
        Bytes.
    output : str or Path
        What messages call it.
    words : str
        How sure that is, such as "at least".

    Raises
    ------
    OutputError
        Saying how much is needed and how much is free.
    """
    place = next(part for part in (folder, *folder.parents) if os.path.lexists(part))
    try:
        free = shutil.disk_usage(place).free
    except OSError:
        # A file system that does not say; it will fail when it is full.
        return
    if needed > free:
        raise OutputError(
            f"{output}: takes {words} {needed / 2**30:.3g} GiB, {free / 2**30:.3g} GiB are free",
            hint="free some space, or choose a folder on another disk",
        )
