"""What an estimate chooses by itself from its capture: the regularization of rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.solvers.default_regularization import default_regularization
from lightmatrix.solvers.problem import Problem
from lightmatrix.solvers.regularization_path import RegularizationPath, regularization_path

# Rows that are looked at, in stretches spread evenly over the capture.
_STRETCHES, _STRETCH = 32, 64
# Of the rows, the share that may be brighter than the level that samples reach: glints, hot pixels.
_BRIGHTER = 0.01


def reached_level(capture: Capture) -> float:
    """The level that samples reach, at most that at which the longest exposed frames clip.

    The 0.99 quantile over camera samples of the largest value under any pattern. An estimate scales
    with its samples if the regularization does, so that a dark capture, which reaches half of its
    clip level, wants half the regularization.

    Parameters
    ----------
    capture : Capture

    Returns
    -------
    float
        At exposure 1, in units of the clip level; >= 0.
    """
    values, _, weights = _spread(capture)
    largest = np.where(weights > 0, values, 0).max(axis=1, initial=0)
    if not len(largest):
        return capture.reference_level
    return float(min(np.quantile(largest, 1 - _BRIGHTER), capture.reference_level))


def automatic_regularization(capture: Capture) -> float:
    """`default_regularization` for the level that samples reach and the noise of a usual camera.

    Returns
    -------
    float
        The paper's lambda, in units of camera sample at exposure 1.
    """
    noise = USUAL_NOISE * capture.reference_level
    level = max(reached_level(capture), noise)
    return default_regularization(capture.patterns, level, noise)


def held_out_path(capture: Capture) -> RegularizationPath:
    """Regularization chosen by hold-out on rows spread over the capture.

    Values from twice to a quarter of the automatic one; see `regularization_path`.

    Raises
    ------
    InputError
        If there are too few patterns or rows to set any aside.
    """
    values, clipped, weights = _spread(capture)
    level = np.broadcast_to(np.float32(capture.reference_level), values.shape)
    problem = Problem(
        capture.patterns,
        Samples(values, clipped, level, weights),
        automatic_regularization(capture),
    )
    return regularization_path(problem, factors=(2, 1, 0.7, 0.5, 0.35, 0.25))


def _spread(capture: Capture) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[Any]]:
    """Values, clip states and weights of some rows, (m, K) each."""
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
    return (
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.clipped for part in parts]),
        np.concatenate(weights),
    )
