"""How far a photograph is from that of a black picture to that of a white one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Bright samples, but not single glints.
_BRIGHT = 0.99


def lit_samples(
    white: NDArray[np.floating], black: NDArray[np.floating], clip_level: float
) -> NDArray[np.bool_]:
    """Samples that the projector lights well and that do not clip under white.

    Parameters
    ----------
    white, black : shape of a frame
        Levels under a white and a black picture.
    clip_level : float
        At which the camera clips.

    Returns
    -------
    shape of a frame, bool
    """
    light = white - black
    free = white < 0.98 * clip_level
    return np.asarray(free & (light > 0.1 * np.quantile(light, _BRIGHT)))


def share_of_white(
    frame: NDArray[np.generic],
    white: NDArray[np.floating],
    black: NDArray[np.floating],
    lit: NDArray[np.bool_],
) -> float:
    """How far a frame is from black (0) to white (1), over the samples that are lit."""
    light = (white - black)[lit].astype(np.float64)
    above = np.asarray(frame, np.float64)[lit] - black[lit]
    return float(above @ light / (light @ light))
