"""The noise that a camera is assumed to have, and the weights of frames of different exposures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Standard deviation of a sample's noise where it is not known, as a share of the clip level: that
# of a decent machine vision camera, about one level of 8 bits. Simulations add as much.
USUAL_NOISE = 0.003
# Standard deviation of what a sparse row cannot explain, as a share of the clip level of the
# longest exposure. For most samples this misfit exceeds the noise; weights by the noise alone,
# e^2, would nearly discard short exposures. docs/planning.md compares it with 0 and 1000:
# `python -m benchmarks.exposures --misfit 0`.
MISFIT = 0.03


def frame_weights(exposures: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Weights in the data term of K frames of different exposures e, (K,); None if all are equal.

    Dividing a sample by its exposure multiplies its noise by 1/e. Weights are relative to the
    longest exposure, so that equal exposures weigh 1, however long they are.
    """
    relative = exposures / exposures.max()
    if (relative == 1).all():
        return None
    variance = MISFIT**2 + (USUAL_NOISE / relative) ** 2
    return np.asarray(variance.min() / variance, np.float32)
