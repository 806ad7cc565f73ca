"""Light transport matrices on disk: stores, parts of them, checkpoints, and other programs' files.

- `zarr_store`: writes a whole matrix as a Zarr store, and reads it whole.
- `stored_transport`: reads rows and regions of a store, and relights without loading all of it.
- `column_index`: adds a second copy by columns to a store, for brush strokes.
- `checkpoint`, `tiles`: keep the finished tiles of an estimate that is being computed.
- `exports`, `sparse_npz`: write npz and mat for other programs, and read npz.
- `correspondence_file`: correspondences as npz; `opening`: T or a correspondence.
- `matrix_checks`: check whatever is read, since compiled routines trust indices.
"""

from __future__ import annotations

from lightmatrix.store.checkpoint import ROWS, Checkpoint
from lightmatrix.store.column_index import ColumnIndex, index_columns
from lightmatrix.store.exports import export
from lightmatrix.store.sparse_npz import import_npz
from lightmatrix.store.stored_transport import StoredTransport
from lightmatrix.store.zarr_store import open, save

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
