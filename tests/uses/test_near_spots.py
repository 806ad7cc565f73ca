"""Spots of neighbouring camera pixels are compared as their definition says."""

from __future__ import annotations

import numpy as np

from lightmatrix.uses.separation import by_pixel, near_spots

SHAPE = (7, 9)


def test_spots_of_each_neighbour_are_compared_once() -> None:
    random = np.random.default_rng(3)
    place = random.uniform(0, 4, (63, 2, 2))
    place[random.random((63, 2)) < 0.2] = np.nan
    number = np.arange(126).reshape(63, 2).T.reshape(2, *SHAPE)
    found: set[tuple[int, int]] = set()
    for here, there, near in near_spots(place, SHAPE, reach=2, radius=1.5):
        own = np.broadcast_to(number[here][:, None], near.shape)
        other = np.broadcast_to(number[there], near.shape)
        pairs = list(zip(own[near].tolist(), other[near].tolist(), strict=True))
        assert not found.intersection(pairs)
        found.update(pairs)
    row, col = np.repeat(np.indices(SHAPE).reshape(2, -1), 2, axis=1)
    beside = (abs(row[:, None] - row) <= 2) & (abs(col[:, None] - col) <= 2)
    beside &= (row[:, None] != row) | (col[:, None] != col)
    flat = place.reshape(-1, 2)
    beside &= np.linalg.norm(flat[:, None] - flat, axis=2) <= 1.5
    assert found == set(zip(*(axis.tolist() for axis in beside.nonzero()), strict=True))
    np.testing.assert_array_equal(by_pixel(number), np.arange(126).reshape(63, 2))
