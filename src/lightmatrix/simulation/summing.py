"""Adding up the contributions of many light paths to the entries of a sparse matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


def summed(
    place: NDArray[np.uint32],
    value: NDArray[np.float32],
    direct: NDArray[np.bool_],
    shape: tuple[int, int],
) -> csr_array:
    """Contributions of equal places added up.

    Parameters
    ----------
    place : (n,) uint32
        Row times columns plus column.
    value : (n,) float32
        >= 0; zeros are dropped.
    direct : (n,) bool
        Whether it is direct light.
    shape : (rows, columns)

    Returns
    -------
    csr_array complex64
        As of `trace_block`. The order of the contributions does not change it.
    """
    lit = value > 0
    bits = value[lit].view(np.uint32) | (direct[lit].astype(np.uint32) << np.uint32(31))
    # Place above value, and the value's unused sign for direct light: one sort of integers groups
    # equal places, several times faster than sorting the places and gathering the values.
    key = (place[lit].astype(np.uint64) << np.uint64(32)) | bits
    key.sort()
    places = (key >> np.uint64(32)).astype(np.uint32)
    bits = key.astype(np.uint32)
    values = (bits & np.uint32(0x7FFFFFFF)).view(np.float32).astype(np.float64)
    new = np.ones(len(places), bool)
    np.not_equal(places[1:], places[:-1], out=new[1:])
    starts = np.flatnonzero(new)
    data = np.empty(len(starts), np.complex64)
    if len(starts):
        data.real = np.add.reduceat(values, starts)
        data.imag = np.add.reduceat(values * (bits >> np.uint32(31)), starts)
    row, column = np.divmod(places[starts], np.uint32(shape[1]))
    indptr = np.searchsorted(row, np.arange(shape[0] + 1))
    return csr_array((data, column.astype(np.int32), indptr.astype(np.int32)), shape=shape)
