"""Tiles of an image: those that changed, and their values in half precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Rows and columns of a tile.
TILE = 64
# The largest number in half precision is 65504. The largest value becomes this one, so that values
# a thousand million times weaker still have all 11 bits.
_TOP = 60000.0
# Rectangles: top, left, rows and columns of each.
Tiles = list[tuple[int, int, int, int]]


def tiles_above(image: NDArray[np.floating], most: float) -> Tiles:
    """The tiles of an image (rows, cols, channels) in which any value is larger than `most`."""
    rows, cols = image.shape[:2]
    tops, lefts = np.arange(0, rows, TILE), np.arange(0, cols, TILE)
    by_pixel = image[..., 0] if image.shape[2] == 1 else image.max(axis=2)
    largest = np.maximum.reduceat(np.maximum.reduceat(by_pixel, tops), lefts, axis=1)
    return [
        (top, left, min(TILE, rows - top), min(TILE, cols - left))
        for top, left in (TILE * np.argwhere(largest > most)).tolist()
    ]


def tile_values(image: NDArray[np.floating], tiles: Tiles) -> NDArray[Any]:
    """The values of some tiles, one after the other."""
    parts = [image[top : top + rows, left : left + cols].ravel() for top, left, rows, cols in tiles]
    return np.concatenate([np.zeros(0, image.dtype), *parts])


def halves(values: NDArray[np.floating]) -> tuple[NDArray[np.float16], float]:
    """Values in half precision and the factor that they must be multiplied by."""
    largest = float(np.abs(values).max(initial=0))
    scale = largest / _TOP if largest > 0 else 1.0
    return (values / values.dtype.type(scale)).astype(np.float16), scale
