"""Writes light transport matrices for other programs: npz that SciPy loads, and mat for MATLAB."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.io import savemat
from scipy.sparse import csr_array

from lightmatrix.errors import OutputError
from lightmatrix.outputs.kinds import MAT, MAT_MARK, NPZ, export_kind
from lightmatrix.outputs.writing import atomic_file, check_output
from lightmatrix.store.sparse_npz import VERSION
from lightmatrix.transport.matrix import LightTransport

# MATLAB's level-5 files count the bytes of a variable in 32 bits.
_MOST_MAT_BYTES = 2**31
# Bytes of free text with which a mat file begins.
_MAT_TEXT_BYTES = 116
# Bytes of dense rows that are made at once.
_DENSE_BYTES = 64 << 20


def export(
    path: str | Path,
    transport: LightTransport,
    *,
    dense_background: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a light transport matrix for SciPy (.npz) or MATLAB (.mat).

    An npz file holds T as CSR, as `scipy.sparse.load_npz` reads it. Extra keys hold the shapes, the
    background and the provenance, so that `open` returns the same LightTransport, except for the
    diagnostics. A mat file (level 5) holds a sparse double matrix ``T`` and the ``background``. In
    MATLAB, images are stored column by column: show row i as
    ``reshape(T(i, :), fliplr(projector_shape))'``.

    Parameters
    ----------
    path : str or Path
        Ends in .npz or .mat.
    transport : LightTransport
        What to write.
    dense_background : bool
        Spread the background over all entries, so that the matrix is the whole of T: exact, but up
        to M x N entries, 8 bytes each, not compressed. Otherwise the background is stored
        separately and the matrix is the sparse part alone.
    overwrite : bool
        Whether an existing export may be replaced.

    Raises
    ------
    OutputError
        If the file exists, ends otherwise, is too large for MATLAB's format, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.export("T_of_metal.npz", lm.truth("metal").transport())
    """
    kind = export_kind(path)
    check_output(path, kind, overwrite=overwrite)
    matrix, background = _parts(transport, dense_background)
    if kind is MAT:
        if 8 * matrix.nnz >= _MOST_MAT_BYTES:
            raise OutputError(
                f"{path}: {matrix.nnz} entries are too many for a .mat file",
                hint="leave out --dense-background, or export to .npz",
            )
        with atomic_file(path, MAT, overwrite=overwrite) as part:
            _write_mat(part, transport, matrix, background)
        return
    with atomic_file(path, NPZ, overwrite=overwrite) as part:
        # Dense entries hardly compress, and gigabytes of them take minutes.
        _write_npz(part, transport, matrix, background, compressed=not dense_background)


def _write_npz(
    file: Path,
    transport: LightTransport,
    matrix: csr_array,
    background: NDArray[np.float32],
    *,
    compressed: bool,
) -> None:
    write = np.savez_compressed if compressed else np.savez
    # NumPy would add its own ending to a name whose ending is in capitals.
    with file.open("wb") as stream:
        write(
            stream,
            # First, so that even a file that was cut off is recognized as ours.
            lightmatrix_transport=np.array(VERSION),
            format=np.array(b"csr"),
            _is_array=np.array(True),
            shape=np.array(matrix.shape),
            data=matrix.data,
            indices=matrix.indices,
            indptr=matrix.indptr,
            camera_shape=np.array(transport.camera_shape),
            projector_shape=np.array(transport.projector_shape),
            background=background,
            background_grid=np.array(transport.background_grid),
            metadata=np.array(json.dumps(dict(transport.provenance), default=str)),
        )


def _write_mat(
    file: Path, transport: LightTransport, matrix: csr_array, background: NDArray[np.float32]
) -> None:
    content: dict[str, Any] = {
        # MATLAB only has sparse matrices of doubles, compressed by columns.
        "T": sparse.csc_array(matrix, dtype=np.float64),
        "background": background,
        "background_grid": np.array(transport.background_grid, np.float64),
        "camera_shape": np.array(transport.camera_shape, np.float64),
        "projector_shape": np.array(transport.projector_shape, np.float64),
        "lightmatrix_version": float(VERSION),
    }
    savemat(file, content, appendmat=False, do_compression=True)
    with file.open("r+b") as written:
        written.write(MAT_MARK.encode().ljust(_MAT_TEXT_BYTES))


def _parts(
    transport: LightTransport, dense_background: bool
) -> tuple[csr_array, NDArray[np.float32]]:
    """The matrix to write and the background that it leaves out."""
    if not dense_background or not transport.background.any():
        return transport.sparse, transport.background
    rows, pixels = transport.shape
    dense = transport.background.any(axis=1)
    # Arrays of the greatest possible size, so that entries are stored once, not joined at the end.
    bound = int(dense.sum()) * pixels + int(np.diff(transport.sparse.indptr)[~dense].sum())
    data = np.empty(bound, np.float32)
    # Both index arrays have one type: SciPy would copy them to the wider one.
    indptr = np.zeros(rows + 1, np.int32 if bound < 2**31 else np.int64)
    indices = np.empty(bound, indptr.dtype)
    step = max(1, _DENSE_BYTES // (4 * pixels))
    for start in range(0, rows, step):
        chunk = np.arange(start, min(start + step, rows))
        tile = csr_array(transport.dense_rows(chunk))
        at = indptr[start]
        data[at : at + tile.nnz] = tile.data
        indices[at : at + tile.nnz] = tile.indices
        indptr[start + 1 : start + len(chunk) + 1] = at + tile.indptr[1:]
    end = int(indptr[-1])
    matrix = csr_array((data[:end], indices[:end], indptr), shape=(rows, pixels))
    return matrix, np.zeros_like(transport.background)
