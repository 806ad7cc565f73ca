"""A truth as a colour camera sees it under one primary of a colour projector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.simulation.truth import Truth

# The share of each primary's light that passes the filter of each camera channel, as (channel,
# primary) in the order red, green, blue. Chosen by hand to overlap about as much as the filters of
# real cameras.
FILTERS: NDArray[np.float32] = np.array(
    [[1.0, 0.2, 0.03], [0.12, 1.0, 0.15], [0.03, 0.2, 1.0]], np.float32
)
FILTERS.setflags(write=False)


def in_primary(truth: Truth, primary: str) -> Truth:
    """T of a scene lit by one primary, with three rows a camera pixel scaled by `FILTERS`."""
    if primary not in COLOURS:
        raise InputError(
            f"there is no primary {primary!r}", hint=f"use one of {', '.join(COLOURS)}"
        )
    number = COLOURS.index(primary)
    band = slice(number, None, 3) if len(truth.camera_shape) == 3 else slice(None)
    rows = np.repeat(np.arange(truth.matrix.shape[0])[band], 3)
    matrix = truth.matrix[rows]
    gains = np.resize(FILTERS[:, number], len(rows)).repeat(np.diff(matrix.indptr))
    scaled = replace(truth, matrix=matrix).with_data(gains * matrix.data)
    return replace(
        truth,
        matrix=scaled,
        direct_data=gains * truth.direct[rows].data,
        camera_shape=(*truth.camera_shape[:2], 3),
        metadata={**truth.metadata, "primary": primary},
    )
