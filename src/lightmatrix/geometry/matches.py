"""Robust fits to matches of camera and projector pixels, some of which are wrong.

Parallel epipolar lines, a fundamental matrix and a homography are found alike: from the best of
many random sets of matches where a start is needed, then by least squares, reweighted such that
matches that are off by several standard deviations hardly count. Points are (n, 2), in any order of
row and column that both devices share.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Tuning:
    """Settings that all fits share. Matches are known to about a tenth of a pixel."""

    # Random sets of matches that are tried, and the matches that judge them. With six of ten
    # matches right, 500 sets of eight miss a right one with a probability below 1e-3.
    trials: int = 500
    judges: int = 2000
    # A match supports a model within this distance, in pixels. Chosen by hand.
    support: float = 0.5
    # Rounds of reweighting. Weights change by less than a per cent after five on real boards.
    rounds: int = 20
    # The least standard deviation of distances in pixels, so that exact matches divide by no 0; and
    # that of parallel lines, whose matches are spots of light.
    least_spread: float = 0.005
    least_spread_of_spots: float = 0.05


ROBUST = _Tuning()


def _reweighted(
    solve: Callable[[Array], Array],
    distances: Callable[[Array], Array],
    model: Array,
    per_median: float = 1.48,
    least: float = ROBUST.least_spread,
) -> Array:
    """The model by iterated least squares: `solve` leads from weights (n,) to the next one.

    A median of 1 belongs to a standard deviation of 1.48 in one dimension, and of 0.848 in two.
    """
    for _ in range(ROBUST.rounds):
        distance = distances(model)
        spread = max(per_median * float(np.median(np.abs(distance))), least)
        model = solve(1 / (1 + (distance / (2 * spread)) ** 2) ** 2)
    return model


def fit_fundamental(camera: Array, projector: Array, *, parallel: bool = False) -> Array:
    """F (3, 3) of norm 1 with (projector, 1) F (camera, 1)' = 0 from n >= 8 matches.

    Hartley, "In defense of the eight-point algorithm", PAMI 1997. Of parallel lines, for which 4
    matches suffice, F holds two numbers of each point and one more.
    """
    before, after = _unit_spread(camera), _unit_spread(projector)
    own, other = _with_ones(moved(before, camera)), _with_ones(moved(after, projector))
    free = [2, 5, 6, 7, 8] if parallel else [*range(9)]
    design = (other[:, :, None] * own[:, None, :]).reshape(-1, 9)[:, free]

    def of_rank_two(numbers: Array) -> Array:
        every = np.zeros((numbers.size // len(free), 9))
        every[:, free] = numbers
        matrices = every.reshape(-1, 3, 3)
        # That of parallel lines has no other rank.
        if not parallel:
            left, values, right = np.linalg.svd(matrices)
            values[:, 2] = 0
            matrices = (left * values[:, None, :]) @ right
        return np.asarray(after.T @ matrices @ before)

    def solve(weight: Array) -> Array:
        moment = (design * weight[:, None]).T @ design
        return np.asarray(of_rank_two(np.linalg.eigh(moment)[1][:, 0])[0])

    random = np.random.default_rng(0)
    judges = random.permutation(len(camera))[: ROBUST.judges]
    sets = judges[random.integers(len(judges), size=(ROBUST.trials, len(free) - 1))]
    candidates = of_rank_two(np.linalg.svd(design[sets])[2][:, -1])
    support = [
        (np.abs(sampson(each, camera[judges], projector[judges])) < ROBUST.support).sum()
        for each in candidates
    ]
    start = candidates[int(np.argmax(support))]
    least = ROBUST.least_spread_of_spots if parallel else ROBUST.least_spread
    matrix = _reweighted(solve, lambda m: sampson(m, camera, projector), start, least=least)
    return matrix / np.linalg.norm(matrix)


def sampson(matrix: Array, camera: Array, projector: Array) -> Array:
    """Signed Sampson distances (n,) of matches to F: how far both must move, in pixels."""
    at_projector = camera @ matrix[:, :2].T + matrix[:, 2]
    at_camera = projector @ matrix[:2] + matrix[2]
    value = (projector * at_projector[:, :2]).sum(axis=1) + at_projector[:, 2]
    slope = (at_projector[:, :2] ** 2).sum(axis=1) + (at_camera[:, :2] ** 2).sum(axis=1)
    return np.asarray(value / np.sqrt(np.maximum(slope, 1e-30)))


def fit_homography(source: Array, target: Array, weight: Array) -> Array:
    """The homography (3, 3) from points to points, n >= 4, with weights (n,).

    Linear least squares in coordinates of unit spread (Hartley 1997).
    """
    before, after = _unit_spread(source), _unit_spread(target)
    start, end = _with_ones(moved(before, source)), moved(after, target)
    zero = np.zeros_like(start)
    rows = np.block([[start, zero, -end[:, :1] * start], [zero, start, -end[:, 1:] * start]])
    known = weight / weight.max()

    def solve(share: Array) -> Array:
        weighted = rows * np.tile(known * share, 2)[:, None]
        matrix = np.linalg.eigh(weighted.T @ rows)[1][:, 0].reshape(3, 3)
        return np.asarray(np.linalg.inv(after) @ matrix @ before)

    def distances(matrix: Array) -> Array:
        return np.asarray(np.linalg.norm(moved(matrix, source) - target, axis=1))

    return _reweighted(solve, distances, solve(np.ones(len(source))), per_median=0.848)


def moved(matrix: Array, points: Array) -> Array:
    """Points after a homography."""
    image = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(image[:, :2] / image[:, 2:])


def _with_ones(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def _unit_spread(points: Array) -> Array:
    """The map (3, 3) that moves points to the origin and gives them a mean distance of about 1."""
    middle = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean())), 1e-12)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])
