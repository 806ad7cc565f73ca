"""Means over the camera's neighbourhoods."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter


def mean_around(image: NDArray[Any], known: NDArray[np.bool_], side: int) -> NDArray[np.float64]:
    """Mean over the known samples of a square around each camera pixel, channel by channel.

    Parameters
    ----------
    image : (rows, cols, channels)
    known : (rows, cols, channels) bool
        Which of its values count.
    side : int
        Camera pixels of a side of the square.

    Returns
    -------
    (rows, cols, channels) float64
        NaN where none is known.
    """
    window = (side, side, 1)
    sums = uniform_filter(np.where(known, image, 0).astype(np.float64), window, mode="nearest")
    shares = uniform_filter(known.astype(np.float64), window, mode="nearest")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(shares > 1e-9, sums / shares, np.nan)
