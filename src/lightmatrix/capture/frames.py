"""Stacks of frames: what a capture needs of its images, on disk or in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
