"""The format in which numbers travel to the page: a header in JSON, then plain arrays."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Tiles of an image: those that changed, and their values in half precision.

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


# The first bytes. The number is the version of the format.
_MAGIC = b"LMVIEW1\n"
# Arrays begin at multiples of this many bytes, as typed arrays of a browser require.
_ALIGNMENT = 8
_DTYPES = {"u1": np.uint8, "u2": np.uint16, "u4": np.uint32, "f2": np.float16, "f4": np.float32}


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A header and arrays as bytes.

    They are: eight letters, the length of the JSON (4 bytes, little endian), the JSON, and the
    arrays. The JSON's ``arrays`` holds the type, the number of values and the offset of each array,
    counted from the end of the JSON.
    """
    places: dict[str, dict[str, Any]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, values in arrays.items():
        kind = f"{values.dtype.kind}{values.dtype.itemsize}"
        raw = np.ascontiguousarray(values, _DTYPES[kind]).astype(f"<{kind}", copy=False).tobytes()
        places[name] = {"type": kind, "count": int(values.size), "offset": offset}
        padding = -len(raw) % _ALIGNMENT
        parts += [raw, bytes(padding)]
        offset += len(raw) + padding
    text = json.dumps({**header, "arrays": places}, allow_nan=False).encode()
    start = len(_MAGIC) + 4
    text += b" " * (-(start + len(text)) % _ALIGNMENT)
    return b"".join([_MAGIC, len(text).to_bytes(4, "little"), text, *parts])
