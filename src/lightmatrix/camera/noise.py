"""What is taken for granted about a camera's noise, and what follows for mixed exposures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Standard deviation of a sample, of the clip level, where it is not known: a decent machine vision
# camera, and what simulations use.
USUAL_NOISE = 0.003
# Of the clip level of the longest exposure: what no sparse row explains. Weights by noise alone,
# e^2, would nearly throw short exposures away, although for most samples the misfit is the larger
# part (docs/planning.md has the measurement).
MISFIT = 0.03


def frame_weights(exposures: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Weights of frames of different exposures in the data term.

    The noise of a sample divided by its exposure e grows by 1/e. Weights are relative to the
    longest exposure, so that equal exposures weigh 1, however long they are.

    Parameters
    ----------
    exposures : (K,) float64
        > 0.

    Returns
    -------
    (K,) float32 or None
        None where all are equal.
    """
    relative = exposures / exposures.max()
    if (relative == 1).all():
        return None
    variance = MISFIT**2 + (USUAL_NOISE / relative) ** 2
    return np.asarray(variance.min() / variance, np.float32)
