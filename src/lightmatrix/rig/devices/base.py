"""What all devices share: addresses, what projectors and cameras can do, exposures and times."""

import re
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.files.extras import load_extra


@dataclass(frozen=True)
class Address:
    """The parts of a device's address: KIND:ARGUMENT,option=value,option=value."""

    # The back end, such as "window" or "aravis".
    kind: str
    # Which of its devices; "" for the first one.
    argument: str = ""
    # Settings by name, as text.
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> "Address":
        """Split an address into its parts; an InputError if an option is given twice.

        >>> Address.parse("aravis:Basler-21,trigger=free,Gain=0")
        Address(kind='aravis', argument='Basler-21', options={'trigger': 'free', 'Gain': '0'})
        """
        # A comma separates options only if NAME= follows; any other comma is part of the argument,
        # such as one in a folder's name.
        device, *settings = re.split(r",(?=[A-Za-z_][A-Za-z0-9_]*=)", text)
        kind, _, argument = device.partition(":")
        options: dict[str, str] = {}
        for setting in settings:
            name, _, value = setting.partition("=")
            if name in options:
                raise InputError(f"{text}: gives {name} twice", hint="give it once")
            options[name] = value
        return cls(kind, argument, options)

    def __str__(self) -> str:
        settings = (f",{name}={value}" for name, value in self.options.items())
        return self.kind + (f":{self.argument}" if self.argument else "") + "".join(settings)

    def check_options(self, known: Sequence[str], *, features: bool = False) -> None:
        """Refuse unknown options; with `features`, names with a capital pass to the camera."""
        for name in self.options:
            if name not in known and not (features and name[0].isupper()):
                offered = ", ".join(known) or "none"
                own = "; features of the camera itself begin with a capital" if features else ""
                hint = f"its options are {offered}{own}"
                raise InputError(f"{self}: {self.kind} has no option {name!r}", hint=hint)

    def number(self, name: str, default: float) -> float:
        """The value of an option that must be a number above 0."""
        text = self.options.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0 < value < float("inf"):
            raise InputError(f"{self}: {name} is {text!r}", hint=f"give {name}=NUMBER above 0")
        return value

    def choice(self, name: str, choices: Sequence[str]) -> str:
        """The value of an option that must be one of a few words; the first one by default."""
        value = self.options.get(name, choices[0])
        if value not in choices:
            hint = f"{name} can be {' or '.join(choices)}"
            raise InputError(f"{self}: {name} is {value!r}", hint=hint)
        return value

    @property
    def stated_exposure(self) -> float:
        """The exposure in seconds that the user set on the camera and states in the address."""
        if "exposure" not in self.options:
            hint = f"set the exposure on the camera by hand, and say it: {self},exposure=SECONDS"
            raise InputError(f"{self}: nothing says how long its frames are exposed", hint=hint)
        return self.number("exposure", 0.0)


@dataclass(frozen=True)
class AvailableDevice:
    """A device that is present: the address that opens it, and what it is in words."""

    address: str
    description: str


def load(extra: str, what: str, *modules: str) -> list[Any]:
    """Import the packages of a back end; a MissingExtraError says how to install them."""
    message = f"{what} cannot be used, a package is not installed"
    return [load_extra(name, message, extra) for name in modules]


def size_in_words(shape: tuple[int, ...]) -> str:
    """The rows and columns of a shape: "768 x 1024"."""
    return f"{shape[0]} x {shape[1]}"


class Clock:
    """The time by which a rig lives; this one is the system's."""

    def now(self) -> float:
        """The time in seconds, as `time.monotonic` counts them."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait; not at all unless the seconds are above 0."""
        if seconds > 0:
            time.sleep(seconds)


@dataclass(frozen=True)
class Frame:
    """One photograph as the camera delivered it."""

    # (rows, cols[, channels]): sensor values, which the frame owns.
    data: NDArray[np.uint8] | NDArray[np.uint16]
    # End of the exposure as well as is known, in seconds of `time.monotonic`.
    timestamp: float
    # The value at which the sensor clips, in units of `data`.
    clip_level: float


class Projector(ABC):
    """Shows one image at a time; subclasses set the shape."""

    _shape: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its pixels."""
        return self._shape

    @abstractmethod
    def info(self) -> dict[str, Any]:
        """JSON-ready facts: at least "name", "shape" and, where known, "refresh" in Hz."""

    @abstractmethod
    def show(self, image: NDArray[np.uint8]) -> float:
        """Show an image (rows, cols) or (rows, cols, 3); return when (`time.monotonic`).

        An InputError says that the image is not of the projector's shape, and a DeviceError that
        the projector is gone.
        """

    def black(self) -> float:
        """Show no light; return when."""
        return self.show(np.zeros(self.shape, np.uint8))

    def asked_to_end(self) -> bool:
        """Whether somebody pressed a key in its window, if it has one."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Give the device back; may be called twice."""


def check_image(image: NDArray[np.uint8], shape: tuple[int, int]) -> None:
    """Refuse an image that a projector of a shape (rows, cols) cannot show pixel by pixel."""
    if image.dtype != np.uint8 or image.shape not in (shape, (*shape, 3)):
        raise InputError(
            f"an image of {image.dtype} and shape {image.shape} for a projector of "
            f"{size_in_words(shape)} pixels",
            hint=f"show uint8 images, 0 to 255, of shape {shape} or {(*shape, 3)}",
        )


class Camera(ABC):
    """Takes photographs. Subclasses have a kind, open the device and set the attributes below."""

    kind: ClassVar[str]
    # Seconds to wait for a frame beyond its exposure.
    patience = 2.0

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
            hint = f"the camera can do {shortest:g} to {longest:g} s"
            raise InputError(f"{self._address}: an exposure of {seconds} s", hint=hint)
        self._write_exposure(seconds)

    def info(self) -> dict[str, Any]:
        """JSON-ready facts about the camera: its name, its shape (rows, cols[, channels]), ..."""
        stated = self._stated
        shortest, longest = self._exposure_range() if stated is None else (stated, stated)
        return {
            "name": self._name, "kind": self.kind, "address": str(self._address),
            "shape": self._shape, "bits": self._bits, **self._details(), "trigger": self._trigger,
            "shortest_exposure": shortest, "longest_exposure": longest,
        }  # fmt: skip

    @abstractmethod
    def get_image(self, timeout: float) -> Frame:
        """The next frame that has not been handed out yet.

        A FrameTimeoutError says that none arrived within the timeout, in seconds, and a DeviceError
        that the camera is gone.
        """

    @abstractmethod
    def flush(self) -> None:
        """Discard frames that were taken but not yet handed out."""

    def trigger(self) -> None:
        """Ask for one frame; a camera that runs freely does nothing."""
        self._check_open()

    def close(self) -> None:
        """Give the device back; may be called twice."""
        if not self._closed:
            self._give_back()
            self._closed = True

    def _give_back(self) -> None:
        """What closing takes."""
        return

    @contextmanager
    def _opening(self) -> Iterator[None]:
        """Give the device back if it cannot be set up."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _details(self) -> dict[str, Any]:
        """Facts that only this kind of camera has."""
        return {}

    # The next three must be there unless the exposure is only stated.
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


def exposure_limits(camera: Camera) -> tuple[float, float]:
    """The shortest and the longest exposure of a camera in seconds, as its `info()` states them.

    A camera that states none is taken to expose for 0.1 ms to 1 s, which nearly all cameras can do.
    More than 10 s are never used: measuring a rig would take hours.
    """
    info = camera.info()
    shortest = float(info.get("shortest_exposure") or 1e-4)
    return shortest, max(shortest, min(float(info.get("longest_exposure") or 1.0), 10.0))


def same_exposure(one: float, other: float) -> bool:
    """Whether two exposures differ by less than 0.1 %.

    Cameras round what they are asked for, mostly to whole microseconds or lines.
    """
    return abs(one - other) <= 1e-3 * other


def set_exposure(camera: Camera, seconds: float) -> float:
    """Set the camera's nearest exposure, unless it is set already, and return what it is."""
    wanted = float(np.clip(seconds, *exposure_limits(camera)))
    if not same_exposure(camera.exposure, wanted):
        camera.exposure = wanted
    return camera.exposure


class FrameStamps:
    """Turns a camera's times of its frames into `time.monotonic`.

    A frame arrives by a delay that varies. The offset of the camera's clock is the smallest
    difference between arrival and stamp over the last frames, so that a frame that waited in a
    queue keeps its time.
    """

    def __init__(self) -> None:
        self._last_stamp = float("-inf")
        # In the time of 100 frames a camera's clock drifts by less than a frame; fewer frames may
        # all have waited in a queue.
        self._offsets: deque[float] = deque(maxlen=100)

    def time(self, stamp: float | None, arrival: float) -> float:
        """When a frame was taken, in `time.monotonic`; never later than it arrived."""
        if stamp is None or stamp <= 0:
            return arrival
        if stamp < self._last_stamp:
            # The camera was restarted, and its clock with it.
            self._offsets.clear()
        self._last_stamp = stamp
        self._offsets.append(arrival - stamp)
        # Rounding may put the sum after the arrival.
        return min(arrival, stamp + min(self._offsets))
