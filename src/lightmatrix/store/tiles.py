"""Tiles of rows as running results keep them: one file each, whose digest shows damage.

The digest covers the arrays, the file's name and the fingerprint of what is computed. So a tile
that was damaged, renamed, or written late by a worker with other settings is computed again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.outputs.running import write_whole
from lightmatrix.transport.sparse_rows import SparseRows

# First row of a tile, and the row after its last.
Span = tuple[int, int]
# The array of a tile's file that holds the digest of all others.
_DIGEST = "digest"


def tile_name(step: str, span: Span) -> str:
    """The name of the file that keeps a tile of a step."""
    return f"{step}-{span[0]}-{span[1]}.npz"


def tile_of(name: str) -> tuple[str, Span] | None:
    """The step and the rows of a tile by its file's name; None if it is no tile's."""
    match = re.fullmatch(r"([a-z0-9-]+)-([0-9]{1,18})-([0-9]{1,18})\.npz", name)
    return None if match is None else (match[1], (int(match[2]), int(match[3])))


def write_tile(file: Path, token: str, rows: SparseRows) -> None:
    """Write a tile in one step, from any process; `token` is that of the fingerprint."""
    with write_whole(file) as part:
        arrays: dict[str, Any] = rows.arrays()
        arrays[_DIGEST] = _digest(file.name, token, arrays)
        np.savez(part, **arrays)


def read_tile(file: Path, token: str, count: int) -> SparseRows | None:
    """A tile of `count` rows; None if it is missing, damaged, or was written for another token."""
    try:
        arrays = read_npz(file)
        digest = arrays.pop(_DIGEST, None)
        if digest is None or digest.dtype != np.uint8:
            return None
        if not np.array_equal(digest, _digest(file.name, token, arrays)):
            return None
        rows = SparseRows.from_arrays(arrays)
    except InputError:
        return None
    return rows if rows.count == count else None


def without_overlap(spans: Iterable[Span]) -> list[Span]:
    """Spans of rows in order, of which a longer one excludes those that overlap it."""
    chosen: list[Span] = []
    for start, stop in sorted(spans, key=lambda span: span[0] - span[1]):
        if start < stop and all(stop <= other[0] or start >= other[1] for other in chosen):
            chosen.append((start, stop))
    return sorted(chosen)


def unfinished_spans(wanted: Iterable[Span], finished: Iterable[Span]) -> list[Span]:
    """The unfinished parts of the wanted spans; both are in order and without overlap."""
    finished, missing = list(finished), []
    for start, stop in wanted:
        for first, last in finished:
            if last > start and first < stop:
                if first > start:
                    missing.append((start, first))
                start = max(start, last)
        if start < stop:
            missing.append((start, stop))
    return missing


def _digest(name: str, token: str, arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Hash of arrays, of their file's name and of what is computed, 32 bytes."""
    hasher = hashlib.sha256(f"{name}\n{token}".encode())
    for key in sorted(arrays):
        values = arrays[key]
        hasher.update(repr((key, values.shape, values.dtype.str)).encode())
        hasher.update(values.tobytes())
    return np.frombuffer(hasher.digest(), np.uint8)
