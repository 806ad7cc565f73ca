"""Spots of global light that lie on the epipolar line by chance, such as mirror images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

# All thresholds of this file were chosen on the scenes of benchmarks/separation_scenes.py.
# Distances are in projector pixels.
#
# A neighbour's spot continues a spot if it holds this share of its light or more.
_CONTINUES = 0.5
# Two spots share a place on the projector if they lie this close to each other. They belong to two
# surfaces if their parallax differs by as much.
_SAME_PLACE = 1.0

Slices = tuple[slice, slice]


def neighbours(shape: tuple[int, int], reach: int) -> Iterator[tuple[Slices, Slices]]:
    """For each neighbour up to `reach` pixels away: the pixels that have it, and where it is."""
    rows, cols = shape
    steps = range(-reach, reach + 1)
    for down, right in ((d, r) for d in steps for r in steps if d or r):
        here = _shifted(rows, -down), _shifted(cols, -right)
        there = _shifted(rows, down), _shifted(cols, right)
        yield here, there


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
    rows, cols = shape
    count = light.shape[1]
    place = relative.reshape(rows, cols, count, 2)
    strength = light.reshape(rows, cols, count)
    near_line = on_line.reshape(rows, cols, count)
    on, off = np.zeros((2, rows, cols, count), np.int8)
    for here, there in neighbours(shape, 1):
        for own in range(count):
            away = place[there] - place[here][:, :, own, None]
            # Comparisons with NaN, where there is no spot, are False.
            continues = away[..., 0] ** 2 + away[..., 1] ** 2 <= radius**2
            continues &= strength[there] >= _CONTINUES * strength[here][:, :, own, None]
            on[here][..., own] += (continues & near_line[there]).any(axis=-1)
            off[here][..., own] += (continues & ~near_line[there]).any(axis=-1)
    return np.asarray(off > np.maximum(on, 1)).reshape(-1, count)


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


def _shifted(size: int, by: int) -> slice:
    """The part of an axis that still lies inside once it is moved back by so many pixels."""
    return slice(max(0, by), size - max(0, -by))
