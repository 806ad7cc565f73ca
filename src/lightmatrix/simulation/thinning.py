"""Fewer entries for the same light: small entries of a row are gathered into fewer ones.

Dropping small entries would darken images. Scaling up the large entries instead would move light
towards them: by 0.3 % of the sum under one block of the corner scene. So every run of dropped
neighbours leaves one entry that stands for them all.
"""

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.transport.sparse_rows import stack_rows

# This many entries are thinned at once. Sorting them takes about 100 bytes each, 200 MiB in all.
_ENTRIES = 1 << 21


def joined(
    parts: list[tuple[csr_array, NDArray[np.float32]]],
) -> tuple[csr_array, NDArray[np.float32]]:
    """Join blocks of rows, and the direct parts of their entries."""
    matrices, direct = zip(*parts, strict=True)
    return stack_rows(matrices), np.concatenate(direct)


def thinned_in_steps(
    matrix: csr_array, direct: NDArray[np.float32], keep: float
) -> tuple[csr_array, NDArray[np.float32]]:
    """`thinned` in bounded memory, some rows at a time."""
    targets = np.arange(_ENTRIES, matrix.nnz, _ENTRIES)
    cuts = np.unique([0, *np.searchsorted(matrix.indptr, targets), matrix.shape[0]])
    return joined(
        [
            thinned(matrix[a:b], direct[matrix.indptr[a] : matrix.indptr[b]], keep)
            for a, b in itertools.pairwise(cuts)
        ]
    )


def thinned(
    matrix: csr_array, direct: NDArray[np.float32], keep: float
) -> tuple[csr_array, NDArray[np.float32]]:
    """Keep the largest entries of each row that hold the share `keep` of its sum, in (0, 1].

    The light of the others is gathered, in the order of pixels, into entries as large as the
    smallest that is kept, and counts as global. Rows keep their sums.
    """
    if keep >= 1:
        return matrix, direct
    count = matrix.shape[0]
    lengths = np.diff(matrix.indptr)
    row = np.repeat(np.arange(count), lengths)
    values = matrix.data.astype(np.float64)
    energy = np.bincount(row, values, count).astype(np.float64)
    ascending = ascending_in_rows(matrix)
    # Drop a row's entries in ascending order while their sum is at most 1 - keep of the row's.
    upto = np.cumsum(ascending, dtype=np.float64) - (np.cumsum(energy) - energy)[row]
    dropped = np.bincount(row[upto <= (1 - keep) * energy[row]], minlength=count)
    smallest = np.full(count, np.inf)
    lit = lengths > 0
    smallest[lit] = ascending[matrix.indptr[:-1][lit] + np.minimum(dropped, lengths - 1)[lit]]
    large = values >= smallest[row]

    # Small entries fill a cup of size `smallest` one after the other. The entry that makes it
    # overflow stays and stands for all that are in it. The cup starts half full, so that the
    # rounding is unbiased.
    small = np.flatnonzero(~large)
    filled = np.cumsum(values[small] / smallest[row[small]])
    before = np.concatenate([[0.0], filled])[np.searchsorted(row[small], np.arange(count))]
    filled += 0.5 - before[row[small]]
    overflows = np.floor(filled) > np.floor(filled - values[small] / smallest[row[small]])
    kept = large.copy()
    kept[small[overflows]] = True
    result = np.where(large, values, smallest[row])[kept]
    direct = np.where(large, direct, np.float32(0))[kept]
    row = row[kept]

    # The last cup of a row is up to half a cup too full or too empty: rescale the row.
    sums = np.bincount(row, result, count)
    result *= np.divide(energy, sums, where=energy > 0, out=np.ones(count))[row]
    values32 = result.astype(np.float32)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=count))])
    indptr = indptr.astype(matrix.indptr.dtype)
    thin = csr_array((values32, matrix.indices[kept], indptr), shape=matrix.shape)
    return thin, np.minimum(direct, values32)


def ascending_in_rows(matrix: csr_array) -> NDArray[np.float32]:
    """The values of each row in ascending order, (nnz,); values must be >= 0."""
    row = np.repeat(np.arange(matrix.shape[0], dtype=np.uint64), np.diff(matrix.indptr))
    # Positive floats sort like their bits, and one sort of integers is the fastest.
    key = (row << np.uint64(32)) | matrix.data.view(np.uint32)
    key.sort()
    return key.astype(np.uint32).view(np.float32)
