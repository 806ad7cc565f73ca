"""Footprints: how many projector pixels a camera pixel sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


def footprint_sizes(rows: csr_array) -> NDArray[np.float64]:
    """The effective number of projector pixels in each row, (M,): (sum t)^2 / sum t^2.

    n equal entries count n; a Gaussian spot of standard deviation s about 4 pi s^2. Rows without
    light have 0. A row with several footprints counts them together.

    Parameters
    ----------
    rows : (M, N) csr_array
        Rows of the light transport matrix, without background.
    """
    light = np.asarray(rows.sum(axis=1), np.float64).ravel()
    squares = np.asarray(rows.multiply(rows).sum(axis=1), np.float64).ravel()
    return np.where(squares > 0, light**2 / np.where(squares > 0, squares, 1), 0)
