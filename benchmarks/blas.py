"""BLAS at its best: what the solver is measured against must not run a kernel of older processors.

OpenBLAS reads its settings when it is loaded, so the process begins anew without them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from typing import Any

# Settings of OpenBLAS that change which kernel runs, and how well.
SETTINGS = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")


def at_its_best() -> None:
    """Begin this program anew without what is set against BLAS, if anything is."""
    environment = without_settings(os.environ)
    if len(environment) < len(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)


def without_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which OpenBLAS chooses for the processor it finds."""
    return {name: value for name, value in environment.items() if name not in SETTINGS}


def kernels() -> list[dict[str, Any]]:
    """Which BLAS is loaded, and the kernel that it runs; empty if nothing tells it."""
    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return []
    return [
        {name: found.get(name) for name in ("internal_api", "version", "architecture")}
        for found in threadpool_info()
        if found.get("user_api") == "blas"
    ]


def told() -> str:
    """The kernels in words."""
    found = {f"{one['internal_api']} {one['version']}, {one['architecture']}" for one in kernels()}
    return "; ".join(sorted(found)) or "unknown (threadpoolctl tells it)"
