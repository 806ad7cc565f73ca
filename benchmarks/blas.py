"""Make BLAS use the processor's own kernel, as the solver is compared with it.

OpenBLAS reads its settings when it is loaded, so the process restarts without them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from typing import Any

# Environment variables of OpenBLAS that choose a kernel or its block size.
SETTINGS = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")


def at_its_best() -> None:
    """Restart this program without these variables, if one is set."""
    environment = without_settings(os.environ)
    if len(environment) < len(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)


def without_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment without these variables."""
    return {name: value for name, value in environment.items() if name not in SETTINGS}


def kernels() -> list[dict[str, Any]]:
    """The loaded BLAS libraries and their kernels; empty without threadpoolctl."""
    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return []
    return [
        {name: library.get(name) for name in ("internal_api", "version", "architecture")}
        for library in threadpool_info()
        if library.get("user_api") == "blas"
    ]


def described() -> str:
    """The kernels in words."""
    names = {f"{one['internal_api']} {one['version']}, {one['architecture']}" for one in kernels()}
    return "; ".join(sorted(names)) or "unknown (install threadpoolctl)"
