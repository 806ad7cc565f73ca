"""How many threads this process uses."""

from __future__ import annotations

import os


def core_threads() -> int:
    """Threads that the compiled core uses."""
    wanted = os.environ.get("RAYON_NUM_THREADS", "")
    return int(wanted) if wanted.isdecimal() and int(wanted) else os.cpu_count() or 1
