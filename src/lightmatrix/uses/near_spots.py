"""Which spots of neighbouring camera pixels lie near each other on the projector."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Places = tuple[slice, slice, slice]


class NearSpots(NamedTuple):
    """One neighbour of all camera pixels that have it.

    `here` are those pixels and `there` their neighbours, in images (SPOTS, rows, cols) of spots.
    `near` (SPOTS, SPOTS, ..., ...) says which spot here, first axis, lies near which spot there.
    """

    here: Places
    there: Places
    near: NDArray[np.bool_]


def near_spots(
    place: NDArray[np.float64], shape: tuple[int, int], *, reach: int, radius: float
) -> Iterator[NearSpots]:
    """For each neighbour up to `reach` pixels away, the spots within `radius` of each other.

    `place` (P, SPOTS, 2) are rows and columns on the projector, NaN where there is no spot.
    """
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    row, col = as_images(place[..., 0], shape), as_images(place[..., 1], shape)
    steps = range(-reach, reach + 1)
    for down, right in ((d, r) for d in steps for r in steps if d or r):
        here = slice(None), _inside(shape[0], -down), _inside(shape[1], -right)
        there = slice(None), _inside(shape[0], down), _inside(shape[1], right)
        # In place, as these are the largest arrays of a separation.
        squared = (row[there] - row[here][:, None]) ** 2
        squared += (col[there] - col[here][:, None]) ** 2
        # Comparisons with NaN are False.
        yield NearSpots(here, there, squared <= radius**2)


def as_images(values: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Values (P, SPOTS) of spots as images (SPOTS, rows, cols)."""
    return np.ascontiguousarray(values.T).reshape(-1, *shape)


def by_pixel(images: NDArray[Any]) -> NDArray[Any]:
    """Images (SPOTS, rows, cols) as values (P, SPOTS)."""
    return np.ascontiguousarray(images.reshape(len(images), -1).T)


def _inside(size: int, by: int) -> slice:
    """The part of an axis that still lies inside once it is moved back by so many pixels."""
    return slice(max(0, by), size - max(0, -by))
