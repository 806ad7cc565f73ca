"""Spots of global light that lie on the epipolar line by chance, such as mirror images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lightmatrix.uses.near_spots import as_images, by_pixel, near_spots

# All thresholds of this file were chosen on the scenes of benchmarks/separation_scenes.py.
# Distances are in projector pixels.
#
# A neighbour's spot continues a spot if it holds this share of its light or more.
_CONTINUES = 0.5
# Two spots share a place on the projector if they lie this close to each other. They belong to two
# surfaces if their parallax differs by as much.
_SAME_PLACE = 1.0


def crossing_spots(
    relative: NDArray[np.float64],
    light: NDArray[np.float64],
    on_line: NDArray[np.bool_],
    shape: tuple[int, int],
    radius: float,
) -> NDArray[np.bool_]:
    """Spots that sweep across the epipolar line from pixel to pixel, (P, SPOTS).

    Direct light stays on the line. A mirror image moves across it, so that the spots of neighbours
    that continue it lie off their lines. Places (P, SPOTS, 2) are `relative` to the mean surface;
    a neighbour's spot continues a spot within `radius` of it, with enough of its light. Of the 8
    neighbours, more than one, and more than half of those that continue it, lie off their lines.
    """
    strength, near_line = as_images(light, shape), as_images(on_line, shape)
    on, off = np.zeros((2, *strength.shape), np.int8)
    for here, there, near in near_spots(relative, shape, reach=1, radius=radius):
        continues = near & (strength[there] >= _CONTINUES * strength[here][:, None])
        on[here] += (continues & near_line[there]).any(axis=1)
        off[here] += (continues & ~near_line[there]).any(axis=1)
    return by_pixel(off > np.maximum(on, 1))


def outshone_spots(
    place: NDArray[np.float64],
    parallax: NDArray[np.float64],
    light: NDArray[np.float64],
    doubtful: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Doubtful spots whose projector pixel lights another surface more brightly, (n,).

    A projector pixel lights one surface, and direct light comes from there. `place` (n, 2),
    `parallax` (n,) and `light` (n,) are those of all spots that may be direct.
    """
    outshone = np.zeros(len(light), bool)
    asked = np.flatnonzero(doubtful)
    if not asked.size:
        return outshone
    found = cKDTree(place).query_ball_point(place[asked], _SAME_PLACE)
    counts = np.array([len(near) for near in found])
    near = np.concatenate(found).astype(np.int64)
    own = np.repeat(np.arange(len(asked)), counts)
    other = np.abs(parallax[near] - parallax[asked][own]) >= _SAME_PLACE
    rivals, held = (np.bincount(own, light[near] * part, len(asked)) for part in (other, ~other))
    outshone[asked] = rivals > held
    return outshone
