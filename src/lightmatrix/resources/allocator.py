"""How the C library of Linux hands freed memory back to the system."""

from __future__ import annotations

import ctypes
import os
import sys

# Arguments of `mallopt` in the GNU C library (malloc.h).
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENAS = -1, -3, -8
# Blocks of up to so many bytes come from the heap. Larger ones are mapped, and unmapped when they
# are freed. The first size is larger than most arrays of a tile; older libraries accept the second
# at most.
_LARGEST_BLOCKS = (128 << 20, 32 << 20)
# Free bytes at the end of the heap that are kept. Chosen by hand: a few arrays of a tile.
_KEPT = 256 << 20


def keep_freed_memory() -> None:
    """Let this process use the memory of freed arrays again; call it before NumPy is loaded.

    Otherwise each large array of a tile is mapped anew, and the system fills its pages with zeros.
    That took two thirds of the system's time of an estimate of 256 x 256 pixels of both. Threads
    share a heap for each core, so that they keep no more memory than without this. Does nothing
    where the C library is another one.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    # It returns 0 if it refuses a value.
    any(mallopt(_MMAP_THRESHOLD, size) for size in _LARGEST_BLOCKS)
    mallopt(_TRIM_THRESHOLD, _KEPT)
    mallopt(_ARENAS, max(2, os.cpu_count() or 1))
