"""Dropping the smallest entries of a matrix without changing what its rows sum to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


def thinned(
    matrix: csr_array, direct: NDArray[np.float32], keep: float
) -> tuple[csr_array, NDArray[np.float32]]:
    """Keep the largest entries of each row that hold the share `keep` of its sum.

    What is dropped goes back to the global parts of the entries that stay, so that images under
    white light do not change.

    Parameters
    ----------
    matrix : (M, N) csr_array float32
        Entries >= 0.
    direct : (matrix.nnz,) float32
        Direct part of each entry.
    keep : float
        In (0, 1]; 1 changes nothing.

    Returns
    -------
    csr_array, (nnz,) float32
        The thinned matrix and the direct part of its entries.
    """
    if keep >= 1:
        return matrix, direct
    count = matrix.shape[0]
    row = np.repeat(np.arange(count), np.diff(matrix.indptr))
    values = matrix.data
    energy = np.bincount(row, values, count)
    # From the smallest entry of each row on, drop while all that is dropped is small enough.
    order = np.lexsort((values, row))
    upto = np.cumsum(values[order], dtype=np.float64) - (np.cumsum(energy) - energy)[row]
    kept = np.zeros(len(row), bool)
    kept[order] = upto > (1 - keep) * energy[row]
    row, values, direct = row[kept], values[kept], direct[kept]
    lost = energy - np.bincount(row, values, count)
    scattered = np.bincount(row, values - direct, count)
    # Where no global light is left, all entries share what was lost; it still counts as global.
    takes = np.where((scattered > 0)[row], values - direct, values)
    taken = np.bincount(row, takes, count)
    gain = np.divide(lost, taken, out=np.zeros(count), where=taken > 0)
    values = values + takes * gain[row].astype(np.float32)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=count))])
    indptr = indptr.astype(matrix.indptr.dtype)
    return csr_array((values, matrix.indices[kept], indptr), shape=matrix.shape), direct
