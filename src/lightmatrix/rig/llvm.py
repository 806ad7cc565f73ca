"""Finding a usable LLVM for the renderer, safely.

Mitsuba's fast variants compile through libLLVM. Version 14 is refused, 15 and 16 abort the whole
process, so every candidate is tried in a child process first.
"""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import subprocess
import sys
import warnings
from functools import cache
from types import ModuleType
from typing import Any

from lightmatrix.errors import LightMatrixWarning, MissingExtraError

_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr;"
    "assert dr.sum(mi.Float([1, 2]))[0] == 3"
)
_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/opt/homebrew/opt/llvm/lib",
)
_TOO_OLD = 17


@cache
def usable_llvm() -> str | None:
    """Path of a libLLVM that renders, "" where the renderer finds one by itself, None if none."""
    own = os.environ.get("DRJIT_LIBLLVM_PATH")
    for path in [own] if own else [*_candidates(), ""]:
        environment = {**os.environ, "DRJIT_LIBLLVM_PATH": path} if path else dict(os.environ)
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=120
        )
        if probe.returncode == 0:
            return path
    return None


def _candidates() -> list[str]:
    """LibLLVM files of version 17 and later, newest first."""
    found: dict[str, int] = {}
    for folder in _FOLDERS:
        for path in glob.glob(f"{folder}/libLLVM*"):
            match = re.search(r"libLLVM[-.](?:so\.|dylib\.)?(\d+)", os.path.basename(path))
            if match and int(match[1]) >= _TOO_OLD:
                found[os.path.realpath(path)] = int(match[1])
    return sorted(found, key=lambda path: -found[path])


@cache
def load_mitsuba(*, scalar: bool = False) -> tuple[ModuleType, bool]:
    """Mitsuba with its variant set, and whether it is a fast (LLVM) one.

    Warns
    -----
    LightMatrixWarning
        Where no usable LLVM is found and the slower scalar variant is taken.

    Raises
    ------
    MissingExtraError
        If Mitsuba is not installed.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise MissingExtraError(
            "rendering needs Mitsuba 3, which is not installed",
            hint="pip install 'lightmatrix[render]'",
        )
    llvm = None if scalar else usable_llvm()
    if llvm:
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba

    mi: Any = mitsuba
    mi.set_variant("scalar_rgb" if llvm is None else "llvm_ad_rgb")
    if llvm is None and not scalar:
        warnings.warn(
            "no usable LLVM was found, so the slow scalar renderer is used; "
            "on Debian and Ubuntu: apt-get install libllvm19 (or `make system-deps`)",
            LightMatrixWarning,
            stacklevel=2,
        )
    return mi, llvm is not None
