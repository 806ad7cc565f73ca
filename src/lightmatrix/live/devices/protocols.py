"""What a projector and a camera are to the rest of the live rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """One photograph as the camera delivered it.

    Parameters
    ----------
    data : (rows, cols) or (rows, cols, channels) uint8 or uint16
        Sensor values; they belong to the frame and do not change any more.
    id : int
        The camera's own number of the frame; one more than that of the frame before it.
    timestamp : float
        When its exposure ended, as well as is known, in seconds of `time.monotonic`.
    clip_level : float
        The value at which the sensor clips, in units of `data`.
    """

    data: NDArray[np.uint8] | NDArray[np.uint16]
    id: int
    timestamp: float
    clip_level: float


class Projector(Protocol):
    """Shows one image at a time."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its pixels."""

    def info(self) -> dict[str, Any]:
        """What it is, JSON-ready: at least "name", "shape" and, where known, "refresh" in Hz."""

    def show(self, image: NDArray[np.uint8]) -> float:
        """Show an image (rows, cols) or (rows, cols, 3), and say when (`time.monotonic`).

        Raises
        ------
        InputError
            If the image is not of the projector's shape.
        DeviceError
            If the projector is gone.
        """

    def black(self) -> float:
        """Show no light, and say when."""

    def close(self) -> None:
        """Give the device back; may be called twice."""


class Camera(Protocol):
    """Takes photographs."""

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, read back from the camera."""

    @exposure.setter
    def exposure(self, seconds: float) -> None: ...

    def info(self) -> dict[str, Any]:
        """What it is, JSON-ready: at least "name", "shape" (rows, cols[, channels]), "bits"."""

    def get_image(self, timeout: float) -> Frame:
        """The next frame that has not been handed out yet.

        Parameters
        ----------
        timeout : float
            Seconds to wait for it.

        Raises
        ------
        FrameTimeoutError
            If none came.
        DeviceError
            If the camera is gone.
        """

    def flush(self) -> None:
        """Throw away frames that were taken but not yet handed out."""

    def trigger(self) -> None:
        """Ask for one frame to be taken now; nothing on a camera that runs freely."""

    def close(self) -> None:
        """Give the device back; may be called twice."""
