"""Tiles of rows as running results keep them: one file each, that is known to be whole and its own.

A tile carries a digest of its arrays, of its name and of the fingerprint of what is computed. So
one that was damaged, renamed, or written late by a worker of other settings is known, and solved
again.
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
from lightmatrix.files.npz import read_npz
from lightmatrix.outputs.running import put
from lightmatrix.transport.sparse_rows import SparseRows

# First row of a tile, and the row after its last.
Span = tuple[int, int]
# The array of a kept file that tells whether the others are those that were kept under its name.
_DIGEST = "digest"


def tile_name(step: str, span: Span) -> str:
    """The name of the file that keeps a tile of a step."""
    return f"{step}-{span[0]}-{span[1]}.npz"


def tile_of(name: str) -> tuple[str, Span] | None:
    """The step and the rows of a tile by its file's name; None if it is no tile's."""
    match = re.fullmatch(r"([a-z0-9-]+)-([0-9]{1,18})-([0-9]{1,18})\.npz", name)
    return None if match is None else (match[1], (int(match[2]), int(match[3])))


def write_tile(file: Path, token: str, rows: SparseRows) -> None:
    """Write a tile in one step, from whichever process.

    Parameters
    ----------
    file : Path
        Where the running results have its place.
    token : str
        Fingerprint of what is computed.
    rows : SparseRows

    Raises
    ------
    OutputError
        If the disk fails.
    """
    with put(file) as part:
        arrays: dict[str, Any] = rows.arrays()
        arrays[_DIGEST] = _digest(file.name, token, arrays)
        np.savez(part, **arrays)


def read_tile(file: Path, token: str, count: int) -> SparseRows | None:
    """A tile of so many rows; None if it is missing, damaged or another's."""
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


def apart(spans: Iterable[Span]) -> list[Span]:
    """Those of some spans of rows that do not overlap, the longest of each place, in order."""
    chosen: list[Span] = []
    for start, stop in sorted(spans, key=lambda span: span[0] - span[1]):
        if start < stop and all(stop <= other[0] or start >= other[1] for other in chosen):
            chosen.append((start, stop))
    return sorted(chosen)


def gaps(wanted: Iterable[Span], there: Iterable[Span]) -> list[Span]:
    """What of the wanted spans is not there, each piece within one of them.

    Parameters
    ----------
    wanted : iterable of (int, int)
        In order, apart.
    there : iterable of (int, int)
        In order, apart.
    """
    held, found = list(there), []
    for start, stop in wanted:
        for first, last in held:
            if last > start and first < stop:
                if first > start:
                    found.append((start, first))
                start = max(start, last)
        if start < stop:
            found.append((start, stop))
    return found


def _digest(name: str, token: str, arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Hash of arrays, of the name that they are kept under, and of what is computed, 32 bytes."""
    hasher = hashlib.sha256(f"{name}\n{token}".encode())
    for key in sorted(arrays):
        values = arrays[key]
        hasher.update(repr((key, values.shape, values.dtype.str)).encode())
        hasher.update(values.tobytes())
    return np.frombuffer(hasher.digest(), np.uint8)
