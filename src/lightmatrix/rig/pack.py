"""Small files for bundled truths: 16-bit columns, half-precision values over each row's maximum.

Rounding a value to half precision changes it by at most 0.05 %, far below the renderer's noise.
Columns are stored as differences within a row and everything is compressed as one npz.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.atomic import atomic_file
from lightmatrix.errors import InputError
from lightmatrix.rig.truth import Truth

_DIRECT_LEVELS = 255


def pack(path: Path, truth: Truth, *, overwrite: bool = False) -> None:
    """Write a truth of at most 65,536 projector pixels as a small file.

    Raises
    ------
    InputError
        If the projector has more pixels than 16 bits count.
    """
    matrix = truth.matrix
    if matrix.shape[1] > 1 << 16:
        raise InputError(
            f"a projector of {matrix.shape[1]} pixels cannot be packed",
            hint="save it as T.npz instead: packed files hold up to 65,536",
        )
    lengths = np.diff(matrix.indptr)
    maximum = _row_maximum(matrix)
    of_entry = np.repeat(maximum, lengths)
    relative = (matrix.data / of_entry).astype(np.float16)
    share = np.rint(truth.direct_data / matrix.data * _DIRECT_LEVELS).astype(np.uint8)
    columns = matrix.indices.astype(np.uint16)
    with atomic_file(path, overwrite=overwrite) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(
            stream,
            lightmatrix_packed=np.array(1),
            lengths=lengths.astype(np.uint16),
            maximum=maximum.astype(np.float32),
            # Differences wrap around at row starts and are undone with the same wrap.
            steps=np.diff(columns, prepend=np.uint16(0)),
            low=relative.view(np.uint16).astype(np.uint8),
            high=(relative.view(np.uint16) >> 8).astype(np.uint8),
            # Most entries are global light only.
            direct_at=np.flatnonzero(share).astype(np.uint32),
            direct_share=share[share > 0],
            camera_shape=np.array(truth.camera_shape),
            projector_shape=np.array(truth.projector_shape),
            metadata=np.array(json.dumps(dict(truth.metadata))),
        )


def unpack(path: Path) -> Truth:
    """Read a packed truth."""
    with np.load(path) as file:
        lengths = file["lengths"].astype(np.int64)
        columns = np.cumsum(file["steps"], dtype=np.uint16).astype(np.int32)
        bits = file["low"].astype(np.uint16) | (file["high"].astype(np.uint16) << 8)
        data = bits.view(np.float16).astype(np.float32) * np.repeat(file["maximum"], lengths)
        share = np.zeros(len(data), np.float32)
        share[file["direct_at"]] = file["direct_share"] / np.float32(_DIRECT_LEVELS)
        camera_shape = tuple(int(v) for v in file["camera_shape"])
        rows, cols = (int(v) for v in file["projector_shape"])
        metadata = json.loads(str(file["metadata"]))
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    shape = (len(lengths), rows * cols)
    matrix = csr_array((data, columns, indptr), shape=shape)
    return Truth(matrix, (data * share).astype(np.float32), camera_shape, (rows, cols), metadata)


def _row_maximum(matrix: csr_array) -> NDArray[np.float64]:
    maximum = np.asarray(matrix.max(axis=1).toarray(), np.float64).ravel()
    return np.where(maximum > 0, maximum, 1.0)
