"""A libLLVM that the renderer can use, found without risk to this process.

Mitsuba's fast variants compile through libLLVM. Version 14 is refused, and 15 and 16 abort the
whole process, so every candidate is first tried in a child process.
"""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import subprocess
import sys
from functools import cache
from types import ModuleType
from typing import Any

from lightmatrix.errors import MissingExtraError, warn

_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr;"
    "assert dr.sum(mi.Float([1, 2]))[0] == 3"
)
# Folders in which Linux distributions and Homebrew install libLLVM.
_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/opt/homebrew/opt/llvm/lib",
)
# Older versions do not work, see above.
_OLDEST = 17


@cache
def usable_llvm() -> str | None:
    """Path of a libLLVM that works; "" if the renderer has its own; None if there is none."""
    own = os.environ.get("DRJIT_LIBLLVM_PATH")
    for path in [own] if own else [*_candidates(), ""]:
        environment = {**os.environ, "DRJIT_LIBLLVM_PATH": path} if path else dict(os.environ)
        if _renders(environment):
            return path
    return None


def _renders(environment: dict[str, str]) -> bool:
    command = [sys.executable, "-c", _PROBE]
    try:
        probe = subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=120
        )
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0


def _candidates() -> list[str]:
    """LibLLVM files of version 17 and later, newest first."""
    versions: dict[str, int] = {}
    for folder in _FOLDERS:
        for path in glob.glob(f"{folder}/libLLVM*"):
            match = re.search(r"libLLVM[-.](?:so\.|dylib\.)?(\d+)", os.path.basename(path))
            if match and int(match[1]) >= _OLDEST:
                versions[os.path.realpath(path)] = int(match[1])
    return sorted(versions, key=lambda path: -versions[path])


def load_mitsuba(*, scalar: bool = False) -> tuple[ModuleType, bool]:
    """Mitsuba and whether it is the LLVM variant; warns if only the slow one is usable."""
    if importlib.util.find_spec("mitsuba") is None:
        raise MissingExtraError(
            "rendering needs Mitsuba 3, which is not installed",
            hint="from the source folder: .venv/bin/pip install -e '.[render]'",
        )
    llvm = None if scalar else usable_llvm()
    if llvm:
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba

    mi: Any = mitsuba
    mi.set_variant("scalar_rgb" if llvm is None else "llvm_ad_rgb")
    if llvm is None and not scalar:
        _warn_once_of_slowness()
    return mi, llvm is not None


@cache
def _warn_once_of_slowness() -> None:
    warn(
        "no usable LLVM was found, so the scalar renderer is used, about a hundred times slower; "
        "on Debian and Ubuntu: apt-get install libllvm19 (or `make system-deps`)",
    )
