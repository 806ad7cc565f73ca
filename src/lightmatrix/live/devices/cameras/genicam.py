"""What cameras with GenICam features do alike: setting up features, pixel format and trigger."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.devices.cameras.base import BaseCamera
from lightmatrix.live.devices.cameras.pixel_formats import PixelFormat, choose_format

# The driver fills this many buffers in turn. Chosen by hand: they hold the frames of a quarter of a
# second at 30 frames a second, while a busy computer does something else.
BUFFERS = 8


class GenICamCamera(BaseCamera):
    """A camera whose settings are GenICam features; options with a capital set them."""

    # Exceptions of the driver when it refuses a feature's value.
    _refusals: tuple[type[Exception], ...]
    # These hints tell the user where the camera lists its features, and their values.
    _features_hint: str
    _values_hint: str
    # What to check when a camera without a cabled trigger delivers nothing.
    _silent_hint: str

    def _configure(self) -> None:
        """Switch off what alters pictures, then set what the address asks for."""
        self._switch_off_automatics()
        options = self._address.options
        for name, value in options.items():
            if name[0].isupper() and name != "PixelFormat":
                self._set_option(name, value)
        offered = self._offered_formats()
        self._format = choose_format(str(self._address), offered, options.get("PixelFormat"))
        self._use_format(self._format)
        self._bits = self._format.bits
        self._trigger = self._choose_trigger()

    def _set_shape(self, rows: int, cols: int) -> None:
        channels = self._format.channels
        self._shape = (rows, cols) if channels == 1 else (rows, cols, channels)

    def _set_option(self, name: str, value: str) -> None:
        if not self._has_feature(name):
            raise self._error(f"the camera has no feature {name}", self._features_hint)
        try:
            self._set_feature(name, value)
        except self._refusals as error:
            refused = f"{name}={value} was refused ({self._reason(error)})"
            raise self._error(refused, self._values_hint) from error

    def _choose_trigger(self) -> str:
        wanted = self._address.options.get("trigger")
        if wanted is None:
            wanted = "software" if self._has_software_trigger() else "free"
        if wanted == "free":
            self._use_trigger(None)
            return wanted
        sources = self._trigger_sources()
        source = "Software" if wanted == "software" else wanted
        if source not in sources:
            raise self._error(
                f"the camera has no trigger {wanted!r}",
                f"its triggers are {', '.join(sources) or 'none'}, and free",
            )
        self._use_trigger(source)
        return wanted

    def _details(self) -> dict[str, Any]:
        return {"pixel_format": self._format.name}

    def _silent(self, timeout: float) -> FrameTimeoutError:
        hint = "is the cable of the trigger connected? trigger=software or trigger=free need none"
        if self._trigger in ("free", "software"):
            hint = self._silent_hint
        return self._timeout(timeout, hint)

    @abstractmethod
    def _switch_off_automatics(self) -> None:
        """Switch off automatic exposure, gain and the like."""

    @abstractmethod
    def _has_feature(self, name: str) -> bool: ...

    @abstractmethod
    def _set_feature(self, name: str, value: str) -> None: ...

    @abstractmethod
    def _reason(self, error: Exception) -> str:
        """The driver's own words for an error."""

    @abstractmethod
    def _offered_formats(self) -> Sequence[str]: ...

    @abstractmethod
    def _use_format(self, chosen: PixelFormat) -> None: ...

    @abstractmethod
    def _has_software_trigger(self) -> bool: ...

    @abstractmethod
    def _trigger_sources(self) -> Sequence[str]: ...

    @abstractmethod
    def _use_trigger(self, source: str | None) -> None:
        """Trigger by a source of the camera; None lets it run freely."""
