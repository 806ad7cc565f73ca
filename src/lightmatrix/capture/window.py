"""A rectangle of a capture's binned camera pixels, as a capture of its own."""

from __future__ import annotations

from dataclasses import replace

from lightmatrix.capture.capture import Capture


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
    corner = (rows.start * down, cols.start * across)
    end = (min(rows.stop * down, height), min(cols.stop * across, width))
    whole = replace(capture, bin_camera=(1, 1))
    part = whole.crop(corner, (end[0] - corner[0], end[1] - corner[1]))
    return replace(part, bin_camera=capture.bin_camera)
