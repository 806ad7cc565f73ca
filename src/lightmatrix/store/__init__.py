"""Light transport matrices on disk: stores, parts of them, checkpoints, and other programs' files.

- `zarr_store`: writes a matrix as a Zarr store, and reads it whole or in parts.
- `column_index`: adds the transposed matrix to a store, for brush strokes.
- `checkpoint`: keeps the finished tiles of an estimate that is being computed.
- `npz`: writes npz and mat for other programs, and reads npz; correspondences as npz.
"""

from __future__ import annotations

from lightmatrix.store.checkpoint import ROWS, Checkpoint
from lightmatrix.store.column_index import ColumnIndex, index_columns
from lightmatrix.store.npz import export, import_npz
from lightmatrix.store.zarr_store import StoredTransport, open, save

__all__ = [
    "ROWS",
    "Checkpoint",
    "ColumnIndex",
    "StoredTransport",
    "export",
    "import_npz",
    "index_columns",
    "open",
    "save",
]
