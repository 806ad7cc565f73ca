"""Stacks of frames: what a capture needs of its images, on disk, in memory or cut out of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.regions import Region
from lightmatrix.reprs import short_repr


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
        """What a message calls a frame."""

    def select(self, index: Sequence[int]) -> Frames:
        """The frames of the given indices."""


@dataclass(frozen=True, eq=False)
class ArrayStack:
    """Frames that are in memory already, such as simulated ones.

    Parameters
    ----------
    array : (K, rows, cols) or (K, rows, cols, channels) uint8, uint16 or float32
    """

    array: NDArray[Any]

    __repr__ = short_repr

    @property
    def count(self) -> int:
        """Number of frames K."""
        return len(self.array)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a frame."""
        return self.array.shape[1:]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the levels."""
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        """One frame."""
        frame: NDArray[Any] = self.array[index]
        return frame

    def name(self, index: int) -> str:
        """The frame's number."""
        return f"frame {index}"

    def select(self, index: Sequence[int]) -> ArrayStack:
        """The frames of the given indices."""
        return ArrayStack(self.array[list(index)])


@dataclass(frozen=True)
class CutFrames:
    """A rectangle of frames, cut out of each as it is read.

    Parameters
    ----------
    frames : Frames
        The whole frames.
    region : Region
        Of these.
    """

    frames: Frames
    region: Region

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.frames.count

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the rectangle."""
        return (*self.region.shape, *self.frames.shape[2:])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the levels."""
        return self.frames.dtype

    def read(self, index: int) -> NDArray[Any]:
        """The rectangle of one frame; a copy, so that the whole is not kept."""
        return self.frames.read(index)[self.region.slices].copy()

    def name(self, index: int) -> str:
        """The whole frame's name."""
        return self.frames.name(index)

    def select(self, index: Sequence[int]) -> CutFrames:
        """The frames of the given indices."""
        return replace(self, frames=self.frames.select(index))


def cut(frames: Frames, corner: tuple[int, int], shape: tuple[int, int]) -> CutFrames:
    """A rectangle of frames, which may be cut already.

    Parameters
    ----------
    frames : Frames
    corner, shape : (int, int)
        Row and column of its first pixel, its rows and columns.

    Raises
    ------
    InputError
        If it does not lie within the frames.
    """
    rows, cols = frames.shape[:2]
    region = Region(corner, shape, (rows, cols))
    if isinstance(frames, CutFrames):
        return CutFrames(frames.frames, region.within(frames.region))
    return CutFrames(frames, region)
