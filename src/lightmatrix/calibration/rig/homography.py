"""Homographies from many noisy matches, some of them wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Rounds of reweighting. Weights change by less than a per cent after five on real boards.
_ROUNDS = 8
# The least standard deviation of matches, in pixels, so that exact ones divide nothing by 0.
_LEAST_SPREAD = 0.01
# The median of the squared length of a two-dimensional error is 1.39 times its variance.
_MEDIAN_OF_SQUARES = 1.39


def fit_homography(
    source: NDArray[np.float64], target: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The homography (3, 3) from points (n, 2) to points (n, 2), n >= 4, with weights (n,).

    Linear least squares in coordinates of unit spread (Hartley 1997), reweighted such that matches
    that are off by several standard deviations hardly count.
    """
    before, after = _unit_spread(source), _unit_spread(target)
    start = np.column_stack([source * before[0, 0] + before[:2, 2], np.ones(len(source))])
    end = target * after[0, 0] + after[:2, 2]
    zero = np.zeros_like(start)
    rows = np.concatenate(
        [
            np.hstack([start, zero, -end[:, :1] * start]),
            np.hstack([zero, start, -end[:, 1:] * start]),
        ]
    )
    share = weight / weight.max()
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        weighted = rows * np.concatenate([share, share])[:, None]
        matrix = np.linalg.eigh(weighted.T @ rows)[1][:, 0].reshape(3, 3)
        image = start @ matrix.T
        error = ((image[:, :2] / image[:, 2:] - end) ** 2).sum(axis=1) / after[0, 0] ** 2
        variance = max(float(np.median(error)) / _MEDIAN_OF_SQUARES, _LEAST_SPREAD**2)
        share = weight / weight.max() / (1 + error / (4 * variance)) ** 2
    return np.asarray(np.linalg.inv(after) @ matrix @ before)


def moved(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) after a homography."""
    image = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(image[:, :2] / image[:, 2:])


def _unit_spread(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The map (3, 3) that moves points to the origin and gives them a mean distance of about 1."""
    middle = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean())), 1e-12)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])
