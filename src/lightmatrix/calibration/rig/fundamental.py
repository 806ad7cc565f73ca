"""The fundamental matrix from many matches, some of them wrong: projective epipolar geometry.

`uses/epipolar.py` has the affine one, which suffices for long lenses and gives no shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Random sets of eight matches that are tried, and the matches that judge them. With a quarter of
# the matches wrong, 300 sets miss a right one with a probability below 1e-13.
_TRIALS, _SET, _JUDGES = 300, 8, 2000
# A match supports a geometry within this Sampson distance, in pixels of both images: places of
# projector pixels are known to about a tenth of a pixel.
_SUPPORT = 0.5
_ROUNDS = 20
# The least standard deviation of distances, so that exact matches divide nothing by 0.
_LEAST_SPREAD = 0.005


def fit_fundamental(
    camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """F (3, 3) with projector' F camera = 0 from matches (n, 2) each, n >= 8, and which fit it."""
    random = np.random.default_rng(0)
    judges = random.permutation(len(camera))[:_JUDGES]
    before, after = _normalisation(camera), _normalisation(projector)
    design = _design(_moved(before, camera), _moved(after, projector))
    sets = random.integers(len(judges), size=(_TRIALS, _SET))
    found = np.linalg.svd(design[judges[sets]])[2][:, -1].reshape(-1, 3, 3)
    candidates = after.T @ _singular(found) @ before
    support = [
        (np.abs(sampson(each, camera[judges], projector[judges])) < _SUPPORT).sum()
        for each in candidates
    ]
    matrix = candidates[int(np.argmax(support))]
    for _ in range(_ROUNDS):
        distance = sampson(matrix, camera, projector)
        spread = max(1.48 * float(np.median(np.abs(distance))), _LEAST_SPREAD)
        weight = 1 / (1 + (distance / (2 * spread)) ** 2) ** 2
        moment = (design * weight[:, None]).T @ design
        solution = np.linalg.eigh(moment)[1][:, 0].reshape(3, 3)
        matrix = after.T @ _singular(solution[None])[0] @ before
    distance = np.abs(sampson(matrix, camera, projector))
    spread = max(1.48 * float(np.median(distance)), _LEAST_SPREAD)
    return matrix / np.linalg.norm(matrix), distance < max(3 * spread, 0.1)


def sampson(
    matrix: NDArray[np.float64], camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Signed Sampson distances (n,) of matches (n, 2): how far both must move, in pixels."""
    at_projector = camera @ matrix[:, :2].T + matrix[:, 2]
    at_camera = projector @ matrix[:2] + matrix[2]
    value = (projector * at_projector[:, :2]).sum(axis=1) + at_projector[:, 2]
    slope = (at_projector[:, :2] ** 2).sum(axis=1) + (at_camera[:, :2] ** 2).sum(axis=1)
    return np.asarray(value / np.sqrt(np.maximum(slope, 1e-30)))


def _design(camera: NDArray[np.float64], projector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The coefficients (n, 9) of F in projector' F camera."""
    one = np.ones((len(camera), 1))
    left, right = np.hstack([projector, one]), np.hstack([camera, one])
    return (left[:, :, None] * right[:, None, :]).reshape(-1, 9)


def _singular(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest matrices (n, 3, 3) of rank 2."""
    left, values, right = np.linalg.svd(matrices)
    values[:, 2] = 0
    return np.asarray((left * values[:, None, :]) @ right)


def _normalisation(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The map (3, 3) that gives points (n, 2) the mean 0 and the spread 1 (Hartley 1997)."""
    middle, spread = points.mean(axis=0), max(float(points.std()), 1e-12)
    return np.array(
        [[1 / spread, 0, -middle[0] / spread], [0, 1 / spread, -middle[1] / spread], [0, 0, 1]]
    )


def _moved(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points * matrix[0, 0] + matrix[:2, 2]
