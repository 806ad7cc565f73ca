"""The hook that Dask runs as a worker of this machine starts.

It has a file of its own, with light imports, so that a worker ignores Ctrl-C before it loads NumPy
and lightmatrix.
"""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the process that started this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
