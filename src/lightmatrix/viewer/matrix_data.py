"""T as the page takes it: column by column, in half precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.packed import packed
from lightmatrix.viewer.tiles import halves

# Row indices below this number take two bytes.
_SHORT_ROWS = 1 << 16
# The page begins with an exposure that shows this share of the pixels of the white image as white.
# Chosen by eye, as in `lightmatrix.pictures.transport`.
_GLINTS = 0.005


def matrix_size(samples: int, pixels: int, entries: int, cells: int) -> int:
    """Bytes that a matrix takes in the page, but for a short header."""
    return entries * (4 if samples <= _SHORT_ROWS else 6) + 4 * (pixels + 1) + 2 * samples * cells


def matrix_data(transport: LightTransport) -> bytes:
    """T as bytes, see `packed`.

    The arrays are ``ends`` (where the entries of each column end, from 0), ``rows`` and ``values``
    of the entries, and ``background``, cell by cell. The values are in half precision, divided by
    ``value_scale`` and ``background_scale``.
    """
    by_columns = csc_array(transport.sparse)
    by_columns.sort_indices()
    short = transport.shape[0] <= _SHORT_ROWS
    values, value_scale = halves(by_columns.data)
    background, background_scale = halves(transport.background)
    header = {
        "value_scale": value_scale,
        "background_scale": background_scale,
        "white": white_level(transport.relight(np.ones(transport.projector_shape))),
    }
    arrays = {
        "ends": by_columns.indptr.astype(np.uint32),
        "rows": by_columns.indices.astype(np.uint16 if short else np.uint32),
        "values": values,
        "background": background.T,
    }
    return packed(header, arrays)


def white_level(image: NDArray[Any]) -> float:
    """The light that is shown as white: that of all but the brightest pixels."""
    level = float(np.quantile(image, 1 - _GLINTS))
    return level if level > 0 else 1.0
