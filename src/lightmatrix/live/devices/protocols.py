"""The contract of projectors and cameras, which every back end keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.live.devices.addresses import size_in_words


@dataclass(frozen=True)
class Frame:
    """One photograph as the camera delivered it.

    Parameters
    ----------
    data : (rows, cols) or (rows, cols, channels) uint8 or uint16
        Sensor values; the frame owns them.
    id : int
        Number of the frame; one more than that of the frame before unless frames were lost.
    timestamp : float
        End of the exposure as well as is known, in seconds of `time.monotonic`.
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
        """JSON-ready facts: at least "name", "shape" and, where known, "refresh" in Hz."""

    def show(self, image: NDArray[np.uint8]) -> float:
        """Show an image (rows, cols) or (rows, cols, 3); return when (`time.monotonic`).

        Raises
        ------
        InputError
            If the image is not of the projector's shape.
        DeviceError
            If the projector is gone.
        """

    def black(self) -> float:
        """Show no light; return when."""

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
        """JSON-ready facts: at least "name", "shape" (rows, cols[, channels]) and "bits"."""

    def get_image(self, timeout: float) -> Frame:
        """The next frame that has not been handed out yet.

        Parameters
        ----------
        timeout : float
            Seconds to wait for it.

        Raises
        ------
        FrameTimeoutError
            If none arrives in time.
        DeviceError
            If the camera is gone.
        """

    def flush(self) -> None:
        """Discard frames that were taken but not yet handed out."""

    def trigger(self) -> None:
        """Ask for one frame to be taken now; a free-running camera does nothing."""

    def close(self) -> None:
        """Give the device back; may be called twice."""


def check_image(image: NDArray[np.uint8], shape: tuple[int, int]) -> None:
    """Refuse an image that a projector of a shape (rows, cols) cannot show pixel by pixel."""
    if image.dtype != np.uint8:
        raise InputError(
            f"an image of {image.dtype} for the projector",
            hint="projectors show uint8, 0 to 255",
        )
    if image.shape not in (shape, (*shape, 3)):
        raise InputError(
            f"an image of shape {image.shape} for a projector of {size_in_words(shape)} pixels",
            hint=f"show images of shape {shape} or {(*shape, 3)}",
        )
