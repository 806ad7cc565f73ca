"""Small files for the bundled truths: places of entries as bits, values as rounded square roots.

The noise of a path tracer's entry grows with the square root of its value. Square roots, rounded to
1/511 of the root of each row's maximum, therefore lose equally little everywhere: about a fifth of
the renderer's own noise at 65,536 paths a pixel. Rows keep their sums to single precision.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.outputs.kinds import PACKED
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.simulation.truth import Truth

FORMAT_VERSION = 1
# Square roots are rounded to this many steps of the root of the row's maximum (9 bits), and direct
# shares to this many steps of 1 (8 bits).
_LEVELS = 511
_DIRECT_LEVELS = 255
# The bit mask of a matrix of M x N places is held in memory as bools, 1 GiB at this size.
_MOST_PLACES = 1 << 30


def write_bundled(path: Path, truth: Truth, *, overwrite: bool = False) -> None:
    """Write a truth as a small file, without entries below 1e-6 of their row's maximum."""
    matrix = truth.matrix
    if matrix.shape[0] * matrix.shape[1] > _MOST_PLACES:
        raise InputError(
            f"a matrix of {matrix.shape[0]} x {matrix.shape[1]} is too large for a bundled file",
            hint="save it as T.npz instead",
        )
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    largest = np.maximum(matrix.max(axis=1).toarray().ravel(), np.finfo(np.float32).tiny)
    level = np.rint(_LEVELS * np.sqrt(matrix.data / largest[row])).astype(np.uint16)
    kept = level > 0
    mask = np.zeros(matrix.shape, bool)
    mask[row[kept], matrix.indices[kept]] = True
    level = level[kept]
    share = np.rint(truth.direct_data[kept] / matrix.data[kept] * _DIRECT_LEVELS).astype(np.uint8)
    with (
        atomic_file(path, PACKED, overwrite=overwrite) as temporary,
        open(temporary, "wb") as stream,
    ):
        np.savez_compressed(
            stream,
            lightmatrix_packed=np.array(FORMAT_VERSION),
            mask=np.packbits(mask),
            level_low=level.astype(np.uint8),
            level_high=np.packbits(level > 255),
            sums=matrix.sum(axis=1).astype(np.float32),
            # Most entries hold no direct light.
            direct_at=np.flatnonzero(share).astype(np.uint32),
            direct_share=share[share > 0],
            camera_shape=np.array(truth.camera_shape),
            projector_shape=np.array(truth.projector_shape),
            metadata=np.array(json.dumps(dict(truth.metadata))),
        )


def read_bundled(path: Path) -> Truth:
    """Read a file of `write_bundled`."""
    content = read_npz(path)
    try:
        version = int(content["lightmatrix_packed"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} is not a bundled scene", hint="install lightmatrix again"
        ) from error
    if version != FORMAT_VERSION:
        raise InputError(
            f"{path} has format version {version}, but this lightmatrix reads {FORMAT_VERSION}",
            hint="update lightmatrix, or install it again",
        )
    sums = content["sums"].astype(np.float64)
    rows, cols = (int(v) for v in content["projector_shape"])
    shape = (len(sums), rows * cols)
    mask = np.unpackbits(content["mask"], count=shape[0] * shape[1]).view(bool).reshape(shape)
    row, column = np.nonzero(mask)
    high = np.unpackbits(content["level_high"], count=len(row)).astype(np.float64)
    squares = np.square(content["level_low"] + 256 * high)
    data = (squares * _unit(squares, row, sums)[row]).astype(np.float32)
    share = np.zeros(len(data), np.float32)
    share[content["direct_at"]] = content["direct_share"] / np.float32(_DIRECT_LEVELS)
    indptr = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    return Truth(
        csr_array((data, column.astype(np.int32), indptr.astype(np.int32)), shape=shape),
        data * share,
        tuple(int(v) for v in content["camera_shape"]),
        (rows, cols),
        json.loads(str(content["metadata"])),
    )


def _unit(
    squares: NDArray[np.float64], row: NDArray[np.int64], sums: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The value of one squared level in each row, such that rows keep their sums."""
    totals = np.bincount(row, squares, len(sums))
    return np.divide(sums, totals, out=np.zeros_like(sums), where=totals > 0)
