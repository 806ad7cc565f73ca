"""Packed frames: those of a capture in one array of Zarr v3, chunked by tiles of camera pixels.

A tile of camera pixels is read without the rest of the frames. docs/store-format.md documents the
format; `packing.py` writes it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.reading import check_image_size
from lightmatrix.files.zarr_arrays import CHUNK, StoredArray, as_damage_error, read_group
from lightmatrix.reprs import ShortRepr

# The attributes of all packed frames state their format and version; others are refused.
FORMAT, VERSION = "lightmatrix-frames", 1
# The group of packed frames in a capture folder, in place of images/, and its array.
PACKED, FRAMES = "images.zarr", "frames"
_REMEDY = "restore it, or pack the capture again"


@dataclass(frozen=True, eq=False, repr=False)
class PackedFrames(ShortRepr):
    """Frames `index` (K',) of a packed capture, read a tile of camera pixels at a time.

    `array` has the raw levels, (K, rows, cols[, channels]), of which the pixels in `rows` and
    `cols` count. A chunk holds all frames of some camera rows, or of a part of one.
    """

    array: StoredArray
    names: tuple[str, ...]
    index: NDArray[np.int64]
    rows: slice
    cols: slice
    # The strip of chunks that was read last. Tiles are smaller than it, and follow each other.
    _last: dict[int, NDArray[Any]] = field(default_factory=dict, repr=False)

    @property
    def count(self) -> int:
        return len(self.index)

    @property
    def shape(self) -> tuple[int, ...]:
        rows, cols = self.rows, self.cols
        return rows.stop - rows.start, cols.stop - cols.start, *self.array.shape[3:]

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        """One frame, for which the chunks of all frames are decompressed."""
        k = int(self.index[index])
        with as_damage_error(self.array.place.parent, _REMEDY):
            return self.array.read(slice(k, k + 1), self.rows, self.cols)[0]

    def name(self, index: int) -> str:
        """The name of the frame before it was packed."""
        return self.names[self.index[index]]

    def select(self, index: Sequence[int]) -> "PackedFrames":
        return replace(self, index=self.index[list(index)], _last={})

    def part(self, rows: slice, cols: slice) -> "PackedFrames":
        top, left = self.rows.start, self.cols.start
        rows = slice(top + rows.start, top + rows.stop)
        return replace(self, rows=rows, cols=slice(left + cols.start, left + cols.stop), _last={})

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        width = int(np.prod(self.shape[1:]))
        levels = np.empty((stop - start, self.count), self.dtype)
        top, end = self.rows.start + start // width, self.rows.start - (-stop // width)
        height = self.array.chunks[1]
        for number in range(top // height, -(-end // height)):
            strip = self._strip(number)
            # The strip's first sample, counted within the rectangle.
            first = (max(number * height, self.rows.start) - self.rows.start) * width
            low, high = max(start, first), min(stop, first + strip.shape[1])
            levels[low - start : high - start] = strip[:, low - first : high - first].T
        return levels

    def _strip(self, number: int) -> NDArray[Any]:
        """Levels of all frames in a row of chunks, as far as it lies in the rectangle, (K', n)."""
        strip = self._last.get(number)
        if strip is None:
            height = self.array.chunks[1]
            rows = slice(
                max(number * height, self.rows.start), min((number + 1) * height, self.rows.stop)
            )
            with as_damage_error(self.array.place.parent, _REMEDY):
                read = self.array.read(slice(None), rows, self.cols)
            strip = read.reshape(len(read), -1)
            if not np.array_equal(self.index, np.arange(len(strip))):
                strip = strip[self.index]
            self._last.clear()
            self._last[number] = strip
        return strip


def open_frames(place: Path) -> PackedFrames:
    """Open packed frames, of which none is read."""
    attributes = read_group(
        place, "set of packed frames", FORMAT, VERSION, "pack the capture again"
    )
    with as_damage_error(place, _REMEDY):
        names = attributes.get("names")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError("its frames have no names")
        # All frames of a pixel lie in one chunk, however many there are.
        array = StoredArray.open(place / FRAMES, max(CHUNK, 3 * len(names)))
        if not names or len(array.shape) not in (3, 4) or array.shape[0] != len(names):
            raise ValueError(f"its frames have shape {array.shape}")
        if array.dtype not in (np.uint8, np.uint16, np.float32) or array.chunks[0] != len(names):
            raise ValueError(f"its frames are {array.dtype} in chunks of {array.chunks[0]} frames")
        check_image_size(place, array.shape[1:])
        _, rows, cols, *_ = array.shape
        every = np.arange(len(names))
        return PackedFrames(array, tuple(names), every, slice(0, rows), slice(0, cols))
