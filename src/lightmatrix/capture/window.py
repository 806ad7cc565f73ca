"""A rectangle of a capture's camera pixels, as a capture of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import Frames, PixelFrames


@dataclass(frozen=True, eq=False)
class _Part:
    """Frames cut to a rectangle as they are read."""

    frames: Frames
    rows: slice
    cols: slice

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.frames.count

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the rectangle."""
        return (
            self.rows.stop - self.rows.start,
            self.cols.stop - self.cols.start,
            *self.frames.shape[2:],
        )

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the levels."""
        return self.frames.dtype

    def read(self, index: int) -> NDArray[Any]:
        """One frame of the rectangle."""
        return np.ascontiguousarray(self.frames.read(index)[self.rows, self.cols])

    def name(self, index: int) -> str:
        """The whole frame's name."""
        return self.frames.name(index)

    def select(self, index: Sequence[int]) -> _Part:
        """The frames of the given indices."""
        return replace(self, frames=self.frames.select(index))


def window(capture: Capture, rows: slice, cols: slice) -> Capture:
    """A rectangle of a capture's camera pixels.

    Parameters
    ----------
    capture : Capture
    rows, cols : slice
        Of its binned camera pixels, with start and stop and without step.

    Returns
    -------
    Capture
        With the camera shape of the rectangle.
    """
    height, width = capture.frames.shape[:2]
    down, across = capture.bin_camera
    inner = slice(rows.start * down, min(rows.stop * down, height))
    beside = slice(cols.start * across, min(cols.stop * across, width))
    decoder = capture.decoder
    if decoder.black_frame is not None:
        black = decoder.black_frame.reshape(capture.frames.shape)[inner, beside]
        decoder = replace(decoder, black_frame=black.ravel())
    mask, frames = capture.mask, capture.frames
    return Capture(
        capture.patterns,
        frames.part(inner, beside)
        if isinstance(frames, PixelFrames)
        else _Part(frames, inner, beside),
        decoder,
        None if mask is None else mask[inner, beside],
        capture.bin_projector,
        capture.bin_camera,
        capture.provenance,
    )
