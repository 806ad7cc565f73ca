"""Seals: what shows that the arrays of a group are those that were written together.

Each chunk ends with a checksum of its content, which decoding verifies. A seal keeps these
checksums of all chunks, so that a sound chunk from elsewhere is noticed when it is read. One digest
covers the checksums, the metadata of the arrays, and facts that belong to them, such as shapes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lightmatrix.files.reading import read_bytes
from lightmatrix.files.zarr_arrays import HEADER, StoredArray

CHECKSUMS, DIGEST = "checksums", "digest"


def sealed(place: Path, names: Iterable[str], facts: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes that seal the arrays of a group, once all of their chunks are written."""
    checksums = {name: StoredArray.open(place / name).checksums() for name in names}
    return {CHECKSUMS: checksums, DIGEST: _digest(place, checksums, facts)}


def sealed_arrays(
    place: Path, names: Iterable[str], attributes: Mapping[str, Any], facts: Mapping[str, Any]
) -> dict[str, StoredArray]:
    """The arrays of a group, whose chunks are compared with the seal as they are read."""
    checksums = attributes[CHECKSUMS]
    names = list(names)
    if not isinstance(checksums, dict) or sorted(checksums) != sorted(names):
        raise ValueError("its arrays are not those that were written together")
    arrays = {name: StoredArray.open(place / name, checksums=checksums[name]) for name in names}
    if attributes[DIGEST] != _digest(place, checksums, facts):
        raise ValueError("its arrays, chunks or shapes are not those that were written together")
    return arrays


def _digest(place: Path, checksums: Mapping[str, str], facts: Mapping[str, Any]) -> str:
    """SHA-256 of the facts and checksums as JSON, then of each array's metadata by its name."""
    hasher = hashlib.sha256(json.dumps([facts, checksums], sort_keys=True).encode())
    for name in sorted(checksums):
        hasher.update(read_bytes(place / name / HEADER))
    return hasher.hexdigest()
