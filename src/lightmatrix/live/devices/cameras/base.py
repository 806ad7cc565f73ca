"""What all cameras do alike: exposures, facts, errors, and being closed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.addresses import Address
from lightmatrix.live.devices.protocols import Frame


class BaseCamera(ABC):
    """A camera: subclasses have a kind, open the device and set the attributes below."""

    kind: ClassVar[str]

    def __init__(self, address: Address) -> None:
        self._address = address
        self._closed = False
        self._name = ""
        # Shape and bits may be known only once a frame has arrived.
        self._shape: tuple[int, ...] | None = None
        self._bits: int | None = None
        self._trigger = "free"
        # Seconds that the user states where the exposure cannot be set from here.
        self._stated: float | None = None

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, read from the camera or as the address states it."""
        return self._read_exposure() if self._stated is None else self._stated

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        if self._stated is not None:
            raise self._error(
                "its exposure cannot be set from here",
                "set it on the camera, and say it in the address: exposure=SECONDS",
            )
        self._check_open()
        shortest, longest = self._exposure_range()
        # The tolerance lets the limits themselves pass after rounding.
        if not shortest * (1 - 1e-9) <= seconds <= longest * (1 + 1e-9):
            raise InputError(
                f"{self._address}: an exposure of {seconds} s",
                hint=f"the camera can do {shortest:g} to {longest:g} s",
            )
        self._write_exposure(seconds)

    def info(self) -> dict[str, Any]:
        """JSON-ready facts about the camera."""
        if self._stated is not None:
            shortest = longest = self._stated
        else:
            shortest, longest = self._exposure_range()
        return {
            "name": self._name,
            "kind": self.kind,
            "address": str(self._address),
            "shape": self._shape,
            "bits": self._bits,
            **self._details(),
            "trigger": self._trigger,
            "shortest_exposure": shortest,
            "longest_exposure": longest,
        }

    @abstractmethod
    def get_image(self, timeout: float) -> Frame:
        """The next frame; see `Camera`."""

    @abstractmethod
    def flush(self) -> None:
        """Discard frames that were taken but not yet handed out."""

    def trigger(self) -> None:
        """Ask for one frame; a camera that runs freely does nothing."""
        self._check_open()

    def close(self) -> None:
        """Give the device back; may be called twice."""
        self._closed = True

    def _details(self) -> dict[str, Any]:
        """Facts that only this kind of camera has."""
        return {}

    def _exposure_range(self) -> tuple[float, float]:
        raise NotImplementedError

    def _read_exposure(self) -> float:
        raise NotImplementedError

    def _write_exposure(self, seconds: float) -> None:
        raise NotImplementedError

    def _check_open(self) -> None:
        if self._closed:
            raise self._error("is closed", "open the camera again")

    def _error(self, what: str, hint: str) -> DeviceError:
        return DeviceError(f"{self._address}: {what}", hint=hint)

    def _timeout(self, timeout: float, hint: str, reason: str = "") -> FrameTimeoutError:
        text = f"{self._address}: no frame within {timeout:g} s{reason}"
        return FrameTimeoutError(text, hint=hint)


def stated_exposure(address: Address) -> float:
    """The exposure in seconds that the user set on the camera and states in the address."""
    if "exposure" not in address.options:
        raise InputError(
            f"{address}: nothing says how long its frames are exposed",
            hint=f"set the exposure on the camera by hand, and say it: {address},exposure=SECONDS",
        )
    return address.number("exposure", 0.0)
