"""The light of a frame as a share of the light of a white frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A sample does not clip under white if it is below this share of the clip level. Chosen by hand:
# 2 % is several times the noise of a sample.
_BELOW_CLIP = 0.98
# A sample is lit if white brightens it by this share of what it does to the brightest ones. Chosen
# by hand: darker samples add noise and hardly any light.
_LIT = 0.1
# The brightest samples are taken at this quantile, so that single glints do not set the measure.
_BRIGHT_QUANTILE = 0.99


def lit_samples(
    white: NDArray[np.floating], black: NDArray[np.floating], clip_level: float
) -> NDArray[np.bool_]:
    """Samples that the projector lights well and that do not clip under white, as a frame.

    `white` and `black` are the levels under a white and a black pattern.
    """
    light = white - black
    unclipped = white < _BELOW_CLIP * clip_level
    return np.asarray(unclipped & (light > _LIT * np.quantile(light, _BRIGHT_QUANTILE)))


def share_of_white(
    frame: NDArray[np.generic],
    white: NDArray[np.floating],
    black: NDArray[np.floating],
    lit: NDArray[np.bool_],
) -> float:
    """How far a frame is from black (0) to white (1): a least-squares fit over the lit samples."""
    light = (white - black)[lit].astype(np.float64)
    above = np.asarray(frame, np.float64)[lit] - black[lit]
    return float(above @ light / (light @ light))
