"""Whether the frames follow the patterns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from lightmatrix.patterns import PatternSet


def check_order(patterns: PatternSet, tiles: Iterable[tuple[int, Any]], rows: int) -> None:
    """To come."""
