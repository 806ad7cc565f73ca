"""A part of the camera that stands for all of it, where the whole would take too long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture


def window_of_light(
    capture: Capture, frames: NDArray[np.int64], samples: int
) -> tuple[slice, slice] | None:
    """The rows and columns around the middle of the light that hold about so many samples.

    `frames` are those whose mean shows where the light is. None if the camera has no more samples.
    """
    rows, cols, *channels = capture.camera_shape
    most = samples // (channels[0] if channels else 1)
    if rows * cols <= most:
        return None
    height = min(rows, max(1, int(np.sqrt(most * rows / cols))))
    width = min(cols, most // height)
    light = mean_image(capture, frames).reshape(rows, cols, -1).sum(axis=2)

    def around_median(profile: NDArray[np.floating], length: int) -> slice:
        total = np.cumsum(np.maximum(profile, 0), dtype=np.float64)
        middle = int(np.searchsorted(total, total[-1] / 2))
        start = int(np.clip(middle - length // 2, 0, len(profile) - length))
        return slice(start, start + length)

    return around_median(light.sum(axis=1), height), around_median(light.sum(axis=0), width)


def mean_image(capture: Capture, frames: NDArray[np.int64]) -> NDArray[np.float32]:
    """The mean of some frames, (M,)."""
    tiles = capture.select(frames).tiles()
    return np.concatenate([tile.values.mean(axis=1) for _, tile in tiles])
