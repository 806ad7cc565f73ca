"""Exact forward simulation: every camera sample under every pattern, before the sensor."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.sparse_rows import row_blocks

_BLOCK_ENTRIES = 1 << 22
# Values of a block of patterns: 4 MiB, measured best at 128 x 128 (two to three times faster than
# all 1,024 patterns at once).
_CACHED_VALUES = 1 << 20


def irradiance(
    matrix: csr_array,
    patterns: PatternSet,
    *,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float32]:
    """T P' for a sparse T: one product, in row blocks over threads.

    Parameters
    ----------
    matrix : (M, N) csr_array float32
        The light transport matrix.
    patterns : PatternSet
        K patterns over N projector pixels.
    threads : int, optional
        None takes one per core. The result does not depend on it.
    progress : callable, optional
        Called with (done, total) rows.

    Returns
    -------
    (M, K) float32
        Linear, not clipped, in camera full scale at exposure 1.

    Raises
    ------
    InputError
        If the patterns do not fit the matrix.
    """
    rows, pixels = matrix.shape
    if pixels != patterns.pixels:
        raise InputError(
            f"patterns of {patterns.shape[0]} x {patterns.shape[1]} pixels for a matrix of "
            f"{pixels} columns",
            hint="make the patterns for the projector of this scene",
        )
    result = np.empty((rows, patterns.count), np.float32)
    # N x some patterns, so that a row's product adds short vectors of a block that stays in cache.
    size = max(16, _CACHED_VALUES // pixels)
    firsts = range(0, patterns.count, size)
    lit = [np.ascontiguousarray(patterns.rows(k, min(k + size, patterns.count)).T) for k in firsts]
    cuts = row_blocks(matrix.indptr, _BLOCK_ENTRIES)

    def multiply(block: int) -> None:
        start, stop = cuts[block], cuts[block + 1]
        rows = matrix[start:stop]
        for k, some in zip(firsts, lit, strict=True):
            result[start:stop, k : k + size] = rows @ some

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for block, _ in enumerate(pool.map(multiply, range(len(cuts) - 1))):
            if progress is not None:
                progress(int(cuts[block + 1]), rows)
    return result
