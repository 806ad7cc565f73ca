"""The projector pixels that explain most of each row of T."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.transport.matrix import LightTransport


def strongest_pixels(
    transport: LightTransport, index: NDArray[np.int64], frames: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The strongest projector pixels of some rows, and their light, (m, count) each.

    There are at most six, and one for five `frames`.
    """
    count = max(1, min(6, frames // 5))
    sparse = transport.sparse[index]
    sizes = np.diff(sparse.indptr)
    owner = np.repeat(np.arange(len(index)), sizes)
    order = np.lexsort((-sparse.data, owner))
    rank = np.arange(len(owner)) - np.repeat(sparse.indptr[:-1], sizes)
    owner, rank, order = (each[rank < count] for each in (owner, rank, order))
    pixels = np.zeros((len(index), count), np.int64)
    light = np.zeros((len(index), count))
    pixels[owner, rank] = sparse.indices[order]
    light[owner, rank] = sparse.data[order]
    return pixels, light
