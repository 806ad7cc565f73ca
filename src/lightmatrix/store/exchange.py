"""Light transport matrices for other programs: npz that SciPy loads, and mat for MATLAB."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.io import savemat
from scipy.sparse import csr_array

from lightmatrix.errors import InputError, OutputError
from lightmatrix.outputs.kinds import MAT, MAT_MARK, NPZ, export_kind
from lightmatrix.outputs.writing import atomic_file, check_output
from lightmatrix.store.sparse_npz import VERSION, read_sparse_npz
from lightmatrix.transport.matrix import LightTransport

# MATLAB's level-5 files count the bytes of a variable in 32 bits.
_MAT_BYTES = 2**31


def export(
    path: str | Path,
    transport: LightTransport,
    *,
    dense_background: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a light transport matrix as .npz (`export_npz`) or .mat (`export_mat`).

    Parameters
    ----------
    path : str or Path
        Ends in .npz, which `scipy.sparse.load_npz` reads, or in .mat.
    transport : LightTransport
        What to write.
    dense_background : bool
        Spread the background over all entries; see `export_npz`.
    overwrite : bool
        Whether an existing export may be replaced.

    Raises
    ------
    OutputError
        If the file exists, ends otherwise, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.export("T_of_metal.npz", lm.truth("metal").transport())
    """
    write = export_mat if export_kind(path) is MAT else export_npz
    write(path, transport, dense_background=dense_background, overwrite=overwrite)


def export_npz(
    path: str | Path,
    transport: LightTransport,
    *,
    dense_background: bool = False,
    overwrite: bool = False,
) -> None:
    """Write T as CSR that `scipy.sparse.load_npz` reads.

    Extra keys hold the shapes, the background and the provenance, so that `import_npz` gives back
    the same LightTransport, diagnostics apart.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    transport : LightTransport
        What to write.
    dense_background : bool
        Spread the background over all entries, so that the CSR matrix is the whole of T: exact,
        but up to M x N entries, 8 bytes each, not compressed. Otherwise the background is
        kept apart and the CSR matrix is the sparse part alone.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    OutputError
        If the file exists, ends otherwise, or cannot be written.
    """
    check_output(path, NPZ, overwrite=overwrite)
    matrix, background = _parts(transport, dense_background)
    # Dense entries hardly compress, and gigabytes of them take minutes.
    write = np.savez if dense_background else np.savez_compressed
    # Given a name, NumPy would add its own ending to one in capitals.
    with atomic_file(path, NPZ, overwrite=overwrite) as part, part.open("wb") as stream:
        write(
            stream,
            # First, so that even a file that was cut off is known as ours.
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


def export_mat(
    path: str | Path,
    transport: LightTransport,
    *,
    dense_background: bool = False,
    overwrite: bool = False,
) -> None:
    """Write T for MATLAB (level 5): a sparse double matrix ``T`` and the ``background``.

    In MATLAB, images are stored column by column: show row i as
    ``reshape(T(i, :), fliplr(projector_shape))'``.

    Raises
    ------
    OutputError
        If the file exists, ends otherwise, is too large for the format, or cannot be written.
    """
    check_output(path, MAT, overwrite=overwrite)
    matrix, background = _parts(transport, dense_background)
    if 8 * matrix.nnz >= _MAT_BYTES:
        raise OutputError(
            f"{path}: {matrix.nnz} entries are too many for a .mat file",
            hint="leave out --dense-background, or export to .npz",
        )
    content: dict[str, Any] = {
        # MATLAB knows sparse matrices of doubles only, and compressed by columns.
        "T": sparse.csc_array(matrix, dtype=np.float64),
        "background": background,
        "background_grid": np.array(transport.background_grid, np.float64),
        "camera_shape": np.array(transport.camera_shape, np.float64),
        "projector_shape": np.array(transport.projector_shape, np.float64),
        "lightmatrix_version": float(VERSION),
    }
    with atomic_file(path, MAT, overwrite=overwrite) as part:
        savemat(part, content, appendmat=False, do_compression=True)
        with part.open("r+b") as written:
            # 116 bytes of free text begin the format.
            written.write(MAT_MARK.encode().ljust(116))


def import_npz(
    path: str | Path,
    camera_shape: tuple[int, ...] | None = None,
    projector_shape: tuple[int, int] | None = None,
) -> LightTransport:
    """Read T from npz: exported by us, a truth file, or a matrix in CSR, CSC or COO form by SciPy.

    Parameters
    ----------
    path : str or Path
        The file.
    camera_shape, projector_shape : tuple of int, optional
        Needed for files that do not hold them.

    Raises
    ------
    InputError
        If it cannot be read, contradicts itself, has no shapes, or is of a later format version.
    """
    found = read_sparse_npz(path)
    camera = camera_shape or found.camera_shape
    projector = projector_shape or found.projector_shape
    if camera is None or projector is None:
        raise InputError(
            f"{path}: does not say the shapes of camera and projector",
            hint="give camera_shape and projector_shape",
        )
    background = found.background
    if background is None:
        background = np.zeros((found.matrix.shape[0], 1), np.float32)
    return LightTransport(
        found.matrix,
        background,
        camera,
        projector,
        found.background_grid,
        provenance=dict(found.metadata),
    )


def _parts(
    transport: LightTransport, dense_background: bool
) -> tuple[csr_array, NDArray[np.float32]]:
    """The matrix to write and the background that it leaves out."""
    if not dense_background or not transport.background.any():
        return transport.sparse, transport.background
    rows, pixels = transport.shape
    dense = transport.background.any(axis=1)
    # An upper bound, so that the entries are stored once and not copied together at the end.
    bound = int(dense.sum()) * pixels + int(np.diff(transport.sparse.indptr)[~dense].sum())
    data = np.empty(bound, np.float32)
    # One type for both indices: SciPy would copy them to the wider one.
    indptr = np.zeros(rows + 1, np.int32 if bound < 2**31 else np.int64)
    indices = np.empty(bound, indptr.dtype)
    step = max(1, (64 << 20) // (4 * pixels))
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
