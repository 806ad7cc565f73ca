"""What calibration needs of a capture: its white image, and the projector pixel each pixel sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.decoding.codes import find_codes
from lightmatrix.decoding.decode import decode
from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.transport.correspondence import Correspondence, correspondence


def pose_images(capture: Capture) -> tuple[NDArray[np.float64], Correspondence]:
    """The image (rows, cols) under white light, and the correspondence.

    Stripes are decoded; of other patterns, T is estimated.
    """
    if stripes_of(capture.patterns) is not None:
        return _white_of_stripes(capture), decode(capture)
    transport = estimate(capture)
    white = transport.relight(np.ones(transport.projector_shape, np.float32))
    return _grey(np.asarray(white, np.float64)), correspondence(transport)


def _white_of_stripes(capture: Capture) -> NDArray[np.float64]:
    """The white frame, or the brightest level of each pixel in frames of stripes."""
    white = find_codes(capture.patterns).white
    if white is not None:
        return _grey(capture.frames.read(white).astype(np.float64))
    brightest = capture.frames.read(0).astype(np.float64)
    for k in range(1, capture.count):
        brightest = np.maximum(brightest, capture.frames.read(k))
    return _grey(brightest)


def _grey(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean over a colour camera's channels."""
    return image if image.ndim == 2 else image.mean(axis=2)
