"""A part of the camera that stands for all of it, where the whole would take too long."""

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


def window_of_levels(capture: Capture, side: int = 64) -> Capture:
    """The capture's window of at most `side` x `side` camera pixels of the most diverse brightness.

    Where all pixels are alike, their photographs hold few levels, and do not determine a curve.
    64 x 64 pixels are enough for the 2,000 rows that tell a response.
    """
    rows, cols = capture.camera_shape[:2]
    high, wide = min(rows, side), min(cols, side)
    if (high, wide) == (rows, cols):
        return capture
    # Its frames tell how bright the camera's pixels are. Chosen by hand: a few light everything.
    frames = np.linspace(0, capture.count - 1, min(8, capture.count)).astype(int)
    some = capture.select(frames)
    spread = np.concatenate([tile.values.std(axis=1) for _, tile in some.tiles()])
    image = spread.reshape(rows, cols, -1).mean(axis=2)
    # A few bright pixels shall not decide, nor dark ones count.
    most = float(np.quantile(image, 0.95))
    # The window has the most even distribution of light over ten levels of brightness, of pixels
    # above 15 % of the brightest, and at least half the light of the brightest window. Chosen on
    # `gripper` at 128 x 128: of its brightest window an S-curve was taken for a gamma, at 17 times
    # the error.
    levels = np.linspace(0.15, 1, 11)[:-1] * most
    level = np.digitize(image, levels) - 1
    sums = np.zeros((10, rows + 1, cols + 1))
    of_levels = np.where(level == np.arange(10)[:, None, None], image, 0)
    sums[:, 1:, 1:] = of_levels.cumsum(axis=1, dtype=np.float64).cumsum(axis=2)
    light = sums[:, high:, wide:] - sums[:, :-high, wide:]
    light = np.maximum(light - sums[:, high:, :-wide] + sums[:, :-high, :-wide], 0)
    whole = light.sum(axis=0)
    shares = light / np.maximum(whole, 1e-12)
    entropy = -(shares * np.log(np.maximum(shares, 1e-12))).sum(axis=0)
    entropy[whole < 0.5 * whole.max()] = -1
    top, left = np.unravel_index(int(entropy.argmax()), entropy.shape)
    return capture.window(slice(int(top), int(top) + high), slice(int(left), int(left) + wide))
