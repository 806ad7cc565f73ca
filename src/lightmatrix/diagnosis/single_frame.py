"""What can be told of one photograph by itself, as a live rig asks after each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.diagnosis.finding import Finding

# Of the samples of one frame.
_MOST_CLIPPED = 2 / 3
# Raw levels above black that the brightest thousandth reaches at least.
_FEWEST_LEVELS = 8


def check_frame(
    image: NDArray[Any],
    decoder: Decoder,
    *,
    index: int = 0,
    lit: bool = True,
    previous: NDArray[Any] | None = None,
) -> list[Finding]:
    """What is wrong with one photograph: too bright, too dark, or the one before once more.

    Parameters
    ----------
    image : (rows, cols[, channels]) uint8, uint16 or float32
        Raw levels.
    decoder : Decoder
        From raw levels to linear samples.
    index : int
        Number of the frame.
    lit : bool
        Whether its pattern is not black.
    previous : like image, optional
        The photograph before it, under another pattern.

    Returns
    -------
    list of Finding
    """
    found = []
    decoded = decoder.decode(image.reshape(-1, 1), first_frame=index)
    clipped = float(decoded.clipped.mean())
    # As one raw level is worth in this frame.
    unit = (
        1.0
        if image.dtype.kind == "f"
        else float(np.max(decoder.clip) - np.min(decoder.black_level))
    )
    exposure = float(
        np.asarray(decoder.exposure).reshape(-1)[index if np.ndim(decoder.exposure) else 0]
    )
    bright = float(np.quantile(decoded.values, 0.999)) * unit * exposure
    if clipped > _MOST_CLIPPED:
        found.append(
            Finding(
                "light",
                (index,),
                f"{100 * clipped:.0f} % of the frame is clipped",
                "expose shorter, or close the aperture",
            )
        )
    elif lit and image.dtype.kind == "u" and bright < _FEWEST_LEVELS:
        found.append(
            Finding(
                "frame",
                (index,),
                "the frame is dark, although its pattern is not",
                "is the projector on, the shutter open, the cap off?",
            )
        )
    if previous is not None and np.array_equal(image, previous):
        found.append(
            Finding(
                "order",
                (index,),
                "the frame is the one before it, bit for bit",
                "the camera delivered an old frame: wait longer, or flush its buffers",
            )
        )
    return found
