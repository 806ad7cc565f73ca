"""Predictions of frames, made by hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.prediction import FramePrediction


def prediction(
    rows: int,
    frames: int,
    *,
    noise: float = 0.0,
    gain: NDArray[np.floating] | float = 1.0,
    seed: int = 0,
) -> FramePrediction:
    """Samples between 0.1 and 1 as expected, times a gain for each frame, and Gaussian noise."""
    expected = np.random.default_rng(17).uniform(0.1, 1, (rows, frames))
    observed = expected * gain
    observed = observed + noise * np.random.default_rng(seed).standard_normal(observed.shape)
    trusted = np.ones((rows, frames), bool)
    return FramePrediction(observed, expected, trusted, np.full(rows, 0.01), (), np.arange(rows))
