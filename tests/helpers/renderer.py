"""Marks of tests that render."""

from __future__ import annotations

import importlib.util

import pytest

from lightmatrix.errors import MissingExtraError
from lightmatrix.simulation.renderer import load_mitsuba

needs_renderer = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="needs the extra `render`"
)


def fast_renderer() -> bool:
    """Whether there is an LLVM to render with; larger tests need it."""
    try:
        load_mitsuba()
    except MissingExtraError:
        return False
    return True


needs_llvm = pytest.mark.skipif(not fast_renderer(), reason="needs LLVM (make system-deps)")
