"""What lightmatrix keeps on disk: matrices, running results, and exchange with other programs."""

from __future__ import annotations

from lightmatrix.store.checkpoint import Checkpoint
from lightmatrix.store.exchange import export, export_mat, export_npz, import_npz
from lightmatrix.store.lazy import StoredTransport
from lightmatrix.store.opening import open
from lightmatrix.store.zarr_file import save

__all__ = [
    "Checkpoint",
    "StoredTransport",
    "export",
    "export_mat",
    "export_npz",
    "import_npz",
    "open",
    "save",
]
