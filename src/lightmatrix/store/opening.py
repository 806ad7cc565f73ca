"""T or a correspondence, whichever a file holds."""

from __future__ import annotations

import zipfile
from pathlib import Path

from lightmatrix.outputs.kinds import CORRESPONDENCE_MARK, holds_member
from lightmatrix.store import zarr_store
from lightmatrix.store.correspondence_file import read_correspondence
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport


def open_matches(
    source: LightTransport | Correspondence | str | Path,
) -> LightTransport | Correspondence:
    """Open a store, a T.npz or a correspondence; what is in memory is returned unchanged."""
    if isinstance(source, LightTransport | Correspondence):
        return source
    path = Path(source)
    if path.suffix.lower() == ".npz" and path.is_file() and _is_correspondence(path):
        return read_correspondence(path)
    return zarr_store.open(path)


def _is_correspondence(file: Path) -> bool:
    """Whether an npz holds a correspondence; damaged files are left to the reader of T to name."""
    try:
        return holds_member(file, CORRESPONDENCE_MARK)
    except (zipfile.BadZipFile, OSError):
        return False
