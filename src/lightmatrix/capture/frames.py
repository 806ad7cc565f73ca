"""Stacks of frames: what a capture needs of its images, whether on disk or in memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_finite, real_array
from lightmatrix.regions import Region
from lightmatrix.reprs import short_repr
from lightmatrix.resources.threads import work_ahead

# Raw levels that are read together, of all frames at some camera pixels. Chosen by hand: they take
# 16 to 64 MB, depending on their type.
BLOCK_LEVELS = 1 << 24


class Frames(Protocol):
    """A stack of frames of one shape and type, read one at a time."""

    @property
    def count(self) -> int:
        """Number of frames K."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels) of a frame."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """uint8, uint16 or float32."""

    def read(self, index: int) -> NDArray[Any]:
        """One frame as it is stored."""

    def name(self, index: int) -> str:
        """The name of a frame in messages."""

    def select(self, index: Sequence[int]) -> Frames:
        """The frames of the given indices."""


@runtime_checkable
class PixelFrames(Frames, Protocol):
    """Frames stored by camera pixel: some pixels in all frames are read fast, a frame slowly."""

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        """Raw levels of the camera samples start..stop in all frames, (stop - start, K)."""

    def part(self, rows: slice, cols: slice) -> PixelFrames:
        """A rectangle of the camera's pixels, with start and stop and without step."""

    def select(self, index: Sequence[int]) -> PixelFrames:
        """The frames of the given indices."""


def in_order(frames: Frames, start: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
    """The frames start..stop one after the other; files are read ahead."""
    stop = frames.count if stop is None else stop
    threads = 1 if isinstance(frames, ArrayStack | PixelFrames) else None
    return work_ahead(frames.read, range(start, stop), threads)


def level_blocks(frames: Frames) -> Iterator[NDArray[Any]]:
    """All raw levels once, in blocks of bounded size, in the fastest order."""
    if not isinstance(frames, PixelFrames):
        yield from in_order(frames)
        return
    pixels, step = math.prod(frames.shape), max(1, BLOCK_LEVELS // frames.count)
    for start in range(0, pixels, step):
        yield frames.levels(start, min(start + step, pixels))


def levels_at(frames: Frames, places: NDArray[np.int64]) -> NDArray[Any]:
    """Raw levels of the camera samples `places`, (S,), in all frames, (S, K), each read once."""
    levels = np.empty((len(places), frames.count), frames.dtype)
    if not isinstance(frames, PixelFrames):
        for k, frame in enumerate(in_order(frames)):
            levels[:, k] = frame.reshape(-1)[places]
        return levels
    start = 0
    for block in level_blocks(frames):
        inside = np.flatnonzero((places >= start) & (places < start + len(block)))
        levels[inside] = block[places[inside] - start]
        start += len(block)
    return levels


@dataclass(frozen=True, eq=False)
class ArrayStack:
    """Frames in memory, (K, rows, cols[, channels]) uint8, uint16 or float32."""

    array: NDArray[Any]

    __repr__ = short_repr

    @property
    def count(self) -> int:
        return len(self.array)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.array.shape[1:]

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        frame: NDArray[Any] = self.array[index]
        return frame

    def name(self, index: int) -> str:
        return f"frame {index}"

    def select(self, index: Sequence[int]) -> ArrayStack:
        return ArrayStack(self.array[list(index)])


def in_memory(frames: Any, mask: Any) -> tuple[ArrayStack, NDArray[np.bool_] | None]:
    """Frames and mask from anything array-like; an InputError says why they are none."""
    array = real_array("frames", frames)
    if array.ndim not in (3, 4) or array.size == 0:
        raise InputError(
            f"frames of shape {array.shape}", hint="give (K, rows, cols) or (K, rows, cols, 3)"
        )
    if mask is None:
        return ArrayStack(array), None
    values = real_array("a mask", mask)
    check_finite("values of a mask", values)
    return ArrayStack(array), np.asarray(values != 0)


@dataclass(frozen=True)
class CutFrames:
    """A rectangle of frames, cut out of each frame as it is read."""

    frames: Frames
    region: Region

    @property
    def count(self) -> int:
        return self.frames.count

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.region.shape, *self.frames.shape[2:])

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.frames.dtype

    def read(self, index: int) -> NDArray[Any]:
        """The rectangle of one frame, as a copy, so that the whole frame is freed."""
        return self.frames.read(index)[self.region.slices].copy()

    def name(self, index: int) -> str:
        return self.frames.name(index)

    def select(self, index: Sequence[int]) -> CutFrames:
        return replace(self, frames=self.frames.select(index))


@dataclass(frozen=True)
class CutPixels(CutFrames):
    """A rectangle of frames that are stored by camera pixel, read as fast as these."""

    frames: PixelFrames

    @cached_property
    def _part(self) -> PixelFrames:
        return self.frames.part(*self.region.slices)

    def read(self, index: int) -> NDArray[Any]:
        """The rectangle of one frame."""
        return self._part.read(index)

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        return self._part.levels(start, stop)

    def part(self, rows: slice, cols: slice) -> PixelFrames:
        return self._part.part(rows, cols)

    def select(self, index: Sequence[int]) -> CutPixels:
        return replace(self, frames=self.frames.select(index))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The black frame and the mask of whole photographs of which a rectangle was taken."""

    black_frame: NDArray[Any] | None
    mask: NDArray[np.bool_] | None


def cut(frames: Frames, corner: tuple[int, int], shape: tuple[int, int]) -> CutFrames:
    """A rectangle of frames, which may themselves be cut, from a corner of (row, col)."""
    rows, cols = frames.shape[:2]
    region = Region(corner, shape, (rows, cols))
    whole = frames
    if isinstance(frames, CutFrames):
        whole, region = frames.frames, region.within(frames.region)
    if isinstance(whole, PixelFrames):
        return CutPixels(whole, region)
    return CutFrames(whole, region)
