"""What cameras with GenICam features do alike: setting up features, pixel format and trigger."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.rig.devices.base import Camera


@dataclass(frozen=True)
class PixelFormat:
    """How a camera's bytes become an image; only formats without packed bits are read."""

    # By the naming convention of GenICam (PFNC).
    name: str
    # Bits of a value that carry light.
    bits: int
    # 1 or 3; a colour filter's mosaic is one channel, each pixel a sample of its own.
    channels: int = 1
    # Whether blue comes first.
    reverse: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a value; the convention prescribes little endian."""
        return np.dtype("u1" if self.bits == 8 else "<u2")

    @property
    def clip_level(self) -> float:
        """The largest value."""
        return float(2**self.bits - 1)

    def image(self, data: bytes, rows: int, cols: int) -> NDArray[Any]:
        """The image in a buffer, which may be longer; a DeviceError if it is shorter."""
        count = rows * cols * self.channels
        if len(data) < count * self.dtype.itemsize:
            raise DeviceError(
                f"the camera delivered {len(data)} bytes for {cols} x {rows} pixels of {self.name}",
                hint="open the camera again",
            )
        flat = np.frombuffer(data, self.dtype, count)
        if self.channels == 1:
            return flat.reshape(rows, cols)
        image = flat.reshape(rows, cols, self.channels)
        return np.ascontiguousarray(image[..., ::-1]) if self.reverse else image


# The formats from best to worst. More bits are better; grey is better than a mosaic, and a mosaic
# better than colours that the camera interpolates.
FORMATS = (
    *(PixelFormat(f"Mono{bits}", bits) for bits in (16, 14, 12, 10)),
    *(
        PixelFormat(f"Bayer{order}{bits}", bits)
        for bits in (16, 14, 12, 10)
        for order in ("RG", "GR", "GB", "BG")
    ),
    PixelFormat("Mono8", 8),
    *(PixelFormat(f"Bayer{order}8", 8) for order in ("RG", "GR", "GB", "BG")),
    PixelFormat("RGB8", 8, 3),
    PixelFormat("RGB8Packed", 8, 3),
    PixelFormat("BGR8", 8, 3, reverse=True),
    PixelFormat("BGR8Packed", 8, 3, reverse=True),
)


def choose_format(camera: str, offered: Sequence[str], wanted: str | None = None) -> PixelFormat:
    """The wanted format, or the best one that a camera offers; a DeviceError if there is none."""
    usable = [known for known in FORMATS if known.name in offered]
    names = ", ".join(known.name for known in usable)
    if wanted is not None:
        chosen = next((known for known in usable if known.name == wanted), None)
        if chosen is None:
            reason = "is not unpacked by us" if wanted in offered else "is not offered by it"
            hint = f"choose one of {names}" if usable else f"it offers {', '.join(offered)}"
            raise DeviceError(f"{camera}: pixel format {wanted} {reason}", hint=hint)
        return chosen
    if not usable:
        listed = ", ".join(offered) or "it has none"
        hint = "switch it to Mono8, Mono16 or RGB8 by its maker's program"
        raise DeviceError(f"{camera}: none of its pixel formats can be read: {listed}", hint=hint)
    return usable[0]


# The driver fills this many buffers in turn. They hold the frames of a quarter of a second at 30
# frames a second, while a busy computer does something else.
BUFFERS = 8


class GenICamCamera(Camera):
    """A camera whose settings are GenICam features; options with a capital set them."""

    # Exceptions of the driver: all, those for a time that is over, and those for a feature's value
    # that it refuses.
    _errors: tuple[type[Exception], ...]
    _timeouts: tuple[type[Exception], ...] = ()
    _refusals: tuple[type[Exception], ...]
    # The driver's own words for an error.
    _reason: Callable[[Exception], str]
    # Automatic exposure, gain and the like.
    _switch_off_automatics: Callable[[], None]
    _has_feature: Callable[[str], bool]
    # By name and value.
    _set_feature: Callable[[str, str], None]
    _offered_formats: Callable[[], Sequence[str]]
    _use_format: Callable[[PixelFormat], None]
    _has_software_trigger: Callable[[], bool]
    _trigger_sources: Callable[[], Sequence[str]]
    # Trigger by a source of the camera; None lets it run freely.
    _use_trigger: Callable[[str | None], None]
    # Trigger by software.
    _fire: Callable[[], None]
    # The exposure in microseconds, read and written.
    _microseconds: Callable[[], float]
    _expose_for: Callable[[float], None]
    # These hints tell the user where the camera lists its features, and their values.
    _features_hint: str
    _values_hint: str
    # What to check when a camera without a cabled trigger delivers nothing.
    _silent_hint: str

    def trigger(self) -> None:
        """Ask for one frame; nothing unless the camera was opened with trigger=software."""
        self._check_open()
        if self._trigger == "software":
            with self._talking("be triggered"):
                self._fire()

    def _read_exposure(self) -> float:
        with self._talking("say its exposure"):
            return self._microseconds() * 1e-6

    def _write_exposure(self, seconds: float) -> None:
        with self._talking("set its exposure"):
            self._expose_for(seconds * 1e6)

    def _configure(self) -> None:
        """Switch off what alters pictures, then set what the address asks for."""
        self._switch_off_automatics()
        options = self._address.options
        for name, value in options.items():
            if not name[0].isupper() or name == "PixelFormat":
                continue
            if not self._has_feature(name):
                raise self._error(f"the camera has no feature {name}", self._features_hint)
            try:
                self._set_feature(name, value)
            except self._refusals as error:
                refused = f"{name}={value} was refused ({self._reason(error)})"
                raise self._error(refused, self._values_hint) from error
        offered = self._offered_formats()
        self._format = choose_format(str(self._address), offered, options.get("PixelFormat"))
        self._use_format(self._format)
        self._bits = self._format.bits
        self._trigger = self._choose_trigger()

    def _set_shape(self, rows: int, cols: int) -> None:
        channels = self._format.channels
        self._shape = (rows, cols) if channels == 1 else (rows, cols, channels)

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

    @contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        """Turn errors of the driver into a DeviceError, except timeouts."""
        self._check_open()
        try:
            yield
        except self._timeouts:
            raise
        except self._errors as error:
            raise self._error(
                f"the camera cannot {doing} ({self._reason(error)})",
                "check its cable and power, and whether another program has it",
            ) from error

    def _details(self) -> dict[str, Any]:
        return {"pixel_format": self._format.name}

    def _silent(self, timeout: float) -> FrameTimeoutError:
        hint = "is the cable of the trigger connected? trigger=software or trigger=free need none"
        if self._trigger in ("free", "software"):
            hint = self._silent_hint
        return self._timeout(timeout, hint)
