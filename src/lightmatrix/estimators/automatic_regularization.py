"""The regularization that an estimate chooses from its capture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.solvers.regularization import default_regularization

# The regularization is chosen from 32 stretches of 64 rows, spread evenly over the capture. The
# values are chosen by hand: 2,048 rows suffice for a 0.99 quantile and are read in an instant.
_STRETCHES, _STRETCH = 32, 64


def reached_level(capture: Capture) -> float:
    """The level that samples reach at exposure 1, at most that at which the longest frames clip.

    It is a quantile over camera samples of the largest value under any pattern. Estimates scale
    with their samples only if the regularization does.
    """
    values, weights = _spread(capture)
    largest = np.where(weights > 0, values, 0).max(axis=1, initial=0)
    if not len(largest):
        return capture.reference_level
    # Glints and hot pixels may be brighter than this quantile. Chosen by hand.
    return float(min(np.quantile(largest, 0.99), capture.reference_level))


def automatic_regularization(capture: Capture) -> float:
    """The paper's lambda for this level and a usual camera's noise, in samples at exposure 1."""
    noise = USUAL_NOISE * capture.reference_level
    level = max(reached_level(capture), noise)
    return default_regularization(capture.patterns, level, noise)


def _spread(capture: Capture) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values and weights of some rows, (m, K) each."""
    count = capture.rows
    if count <= _STRETCHES * _STRETCH:
        starts = np.arange(0, count, _STRETCH)
    else:
        starts = np.linspace(0, count - _STRETCH, _STRETCHES).astype(np.int64)
    parts = [capture.samples(int(s), min(int(s) + _STRETCH, count)) for s in starts]
    ones = np.ones(capture.count, np.float32)
    weights = [
        np.broadcast_to(ones if part.weights is None else part.weights, part.values.shape)
        for part in parts
    ]
    return np.concatenate([part.values for part in parts]), np.concatenate(weights)
