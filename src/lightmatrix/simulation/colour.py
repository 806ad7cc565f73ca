"""A camera of three channels before one primary of a colour projector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.simulation.truth import Truth

# How much of each primary's light passes the filters of the camera's channels: (channel, primary),
# red, green, blue. Filters of cameras overlap; about as much as these.
FILTERS: NDArray[np.float32] = np.array(
    [[1.0, 0.2, 0.03], [0.12, 1.0, 0.15], [0.03, 0.2, 1.0]], np.float32
)
FILTERS.setflags(write=False)


def in_primary(truth: Truth, primary: str) -> Truth:
    """What a colour camera sees of a scene that one primary of a projector lights.

    Parameters
    ----------
    truth : Truth
        T of a grey scene, or of one that was rendered in colour: then the primary is reflected as
        the channel of its name is.
    primary : {"red", "green", "blue"}

    Returns
    -------
    Truth
        With three rows a camera pixel, each by what its filter lets pass (`FILTERS`).

    Raises
    ------
    InputError
        On another primary.
    """
    if primary not in COLOURS:
        raise InputError(f"a primary {primary!r}", hint=f"use {', '.join(COLOURS)}")
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
