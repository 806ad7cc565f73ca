"""What lightmatrix keeps on disk: matrices, running results, and exchange with other programs."""

from __future__ import annotations

from lightmatrix.store.checkpoint import ROWS, Checkpoint
from lightmatrix.store.columns import ColumnIndex, index_columns
from lightmatrix.store.exchange import export, export_mat, export_npz, import_npz
from lightmatrix.store.lazy import StoredTransport
from lightmatrix.store.opening import open
from lightmatrix.store.zarr_file import save

__all__ = [
    "ROWS",
    "Checkpoint",
    "ColumnIndex",
    "StoredTransport",
    "export",
    "export_mat",
    "export_npz",
    "import_npz",
    "index_columns",
    "open",
    "save",
]
