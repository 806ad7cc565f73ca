"""Marks of tests that render."""

from __future__ import annotations

import importlib.util
import warnings

import pytest

from lightmatrix.errors import LightMatrixWarning
from lightmatrix.simulation.renderer import load_mitsuba

needs_renderer = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="needs the extra `render`"
)


def fast_renderer() -> bool:
    """Whether there is an LLVM to render with; larger tests need it."""
    if importlib.util.find_spec("mitsuba") is None:
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LightMatrixWarning)
        return load_mitsuba()[1]


needs_llvm = pytest.mark.skipif(not fast_renderer(), reason="needs LLVM (make system-deps)")
