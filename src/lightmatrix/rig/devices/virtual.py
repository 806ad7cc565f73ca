"""A virtual projector and camera before a scene whose T is known, in real or simulated time."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Address, Camera, Clock, Frame, Projector, check_image
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import PROJECTORS

PREFIX = "virtual:"


@dataclass(frozen=True)
class VirtualSettings:
    """A virtual projector and camera, and the light of their room; times are in seconds."""

    # A scene (see `scenes`), a truth file (T.npz), or "procedural".
    scene: str
    # Pixels along a side of each projector and camera; the bundled scenes have 64.
    size: int = 64
    # Refreshes of the projector between `show` and the light.
    delay: float = 2.0
    # Exponent of the projector: light = (grey value / 255) ** gamma.
    gamma: float = 2.2
    # Room light, as a share of the mean white image.
    room: float = 0.02
    # Frames a second of a free-running camera; 0: one frame for each trigger.
    fps: float = 30.0
    # Exposure time at which a sample is T p, that is exposure 1 of `simulate`.
    unit: float = 0.02
    # Bit depth: 8, 10, 12 or 16.
    bits: int = 12
    # Raw level of a sample without light.
    black: float = 64.0
    # Gamma of the camera, as of webcams, whose levels are light ** (1 / gamma).
    camera_gamma: float = 1.0
    # Read noise, as a share of the clip level.
    noise: float = 0.003
    # Seed of the noise.
    seed: int = 0
    # 1: real time; 0: the clock of the rig jumps instead of waiting.
    real: int = 1
    # Number of the camera, in scenes that have several.
    camera: int = 1

    def __post_init__(self) -> None:
        least = {"size": 2, "gamma": 0.1, "camera_gamma": 0.1, "unit": 1e-6}
        for name, value in vars(self).items():
            if name != "scene" and not least.get(name, 0.0) <= value < math.inf:
                hint = f"use a number from {least.get(name, 0.0):g} on"
                raise InputError(f"a virtual rig with {name}={value:g}", hint=hint)


def parse_settings(text: str) -> VirtualSettings:
    """Read ``virtual:SCENE`` or ``virtual:SCENE,name=value,...``; see `VirtualSettings`.

    >>> parse_settings("virtual:metal,delay=3,seed=7").delay
    3.0
    """
    address = Address.parse(text)
    if address.kind != VirtualCamera.kind or not address.argument:
        hint = "write virtual:SCENE, such as virtual:l_objects, or give a projector and a camera"
        raise InputError(f"a rig of {text!r}", hint=hint)
    kinds: dict[str, Any] = {f.name: f.type for f in fields(VirtualSettings) if f.name != "scene"}
    values: dict[str, Any] = {}
    address.check_options(list(kinds))
    for name, value in address.options.items():
        try:
            values[name] = kinds[name](value)
        except ValueError:
            hint = f"give {name} a {'whole ' * (kinds[name] is int)}number, {name}=1"
            raise InputError(f"a virtual rig with {name}={value}", hint=hint) from None
    return VirtualSettings(address.argument, **values)


@dataclass
class SimulatedClock(Clock):
    """A clock that jumps instead of waiting: an hour of a virtual rig passes in seconds."""

    seconds: float = 0.0

    def now(self) -> float:
        return self.seconds

    def sleep(self, seconds: float) -> None:
        self.seconds += max(0.0, seconds)


@dataclass(frozen=True)
class _Hardware:
    """What all virtual projectors and cameras have in common."""

    # Refresh rate of the projector in Hz.
    refresh: float = 60.0
    # Light of a black projector pixel, as a share of a white one's.
    leak: float = 0.001
    # Frames that a free-running camera keeps; further ones are lost until one is fetched.
    buffers: int = 4
    # Seconds from the trigger to the exposure, and from its end until the frame is ready.
    trigger_delay: float = 1e-4
    latency: float = 0.004
    # The shortest and the longest exposure in seconds; exposures are whole microseconds.
    shortest: float = 20e-6
    longest: float = 10.0


HARDWARE = _Hardware()


class VirtualLight:
    """Irradiance of the camera's M samples over time, from the projector and from the room.

    `truth` is T, including the blur of the projector; `room` (M,) is the room's light.
    """

    def __init__(self, truth: Truth, room: NDArray[np.float32], settings: VirtualSettings) -> None:
        self.truth, self.room, self.settings = truth, room, settings
        black = np.zeros(truth.projector_shape, np.uint8)
        # Times from which on the projector gave an irradiance, in ascending order.
        self._shown = deque([(-math.inf, self.irradiance(black))])

    def irradiance(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """T p (M,) of an image (rows, cols) uint8, with the projector's gamma and leaking black."""
        share = (image.ravel() / 255.0) ** self.settings.gamma
        emitted = HARDWARE.leak + (1 - HARDWARE.leak) * share
        return np.asarray(self.truth.matrix @ emitted.astype(np.float32), np.float32)

    def change(self, when: float, image: NDArray[np.uint8]) -> None:
        """Show an image from some time on; it overtakes one that is later than that."""
        while self._shown and self._shown[-1][0] >= when:
            self._shown.pop()
        self._shown.append((when, self.irradiance(image)))

    def between(self, start: float, stop: float) -> NDArray[np.float32]:
        """Mean irradiance (M,) between two times."""
        total = np.zeros(len(self.room), np.float64)
        for first, last, irradiance in self.parts(start, stop):
            total += (last - first) * irradiance
        total += (stop - start) * self.room
        return np.asarray(total / (stop - start), np.float32)

    def parts(
        self, start: float, stop: float
    ) -> Iterator[tuple[float, float, NDArray[np.float32]]]:
        """The parts of an interval with one image each: their begin, end and irradiance (M,)."""
        # Frames begin at most one longest exposure ago, so older images are forgotten.
        while len(self._shown) > 1 and self._shown[1][0] < start - HARDWARE.longest:
            self._shown.popleft()
        ends = [since for since, _ in list(self._shown)[1:]] + [math.inf]
        for (since, irradiance), end in zip(self._shown, ends, strict=True):
            first, last = max(start, since), min(stop, end)
            if last > first:
                yield first, last, irradiance


class VirtualProjector(Projector):
    """The projector of a virtual rig; it changes the light that the camera photographs."""

    def __init__(self, light: VirtualLight, clock: Clock) -> None:
        self._light, self._clock = light, clock
        self._shape = light.truth.projector_shape
        # The image that was asked for last; None once the projector is closed.
        self.image: NDArray[np.uint8] | None = np.zeros(self.shape, np.uint8)

    def info(self) -> dict[str, Any]:
        sizes = self._light.truth.metadata.get(PROJECTORS)
        return {
            "name": PREFIX + self._light.settings.scene,
            "shape": list(self.shape),
            **({PROJECTORS: sizes} if sizes else {}),
            "refresh": HARDWARE.refresh,
        }

    def show(self, image: NDArray[np.uint8]) -> float:
        if self.image is None:
            raise DeviceError("the virtual projector is closed", hint="open it again")
        check_image(image, self.shape)
        self.image = image
        if image.ndim == 3:
            image = image.mean(axis=2).astype(np.uint8)
        refresh = 1 / HARDWARE.refresh
        now = self._clock.now()
        # Like a window that swaps its buffers, it returns at the next refresh.
        swap = math.ceil(now / refresh) * refresh
        self._clock.sleep(swap - now)
        self._light.change(swap + self._light.settings.delay * refresh, image)
        return self._clock.now()

    def close(self) -> None:
        self.image = None


class VirtualCamera(Camera):
    """The camera of a virtual rig: free-running, with buffers that grow stale, or triggered."""

    kind = "virtual"

    def __init__(self, light: VirtualLight, clock: Clock) -> None:
        super().__init__(Address(self.kind, light.settings.scene))
        self._light, self._clock, self._settings = light, clock, light.settings
        self._name, self._bits = str(self._address), light.settings.bits
        self._shape = light.truth.camera_shape
        self._trigger = "free" if light.settings.fps else "software"
        self._sensor = Sensor(
            black_level=self._settings.black,
            read_noise=self._settings.noise,
            bits=self._settings.bits,
        )
        self._exposure = 0.5 * self._settings.unit
        self._id = 0
        # Frames that were taken, and when they are ready.
        self._waiting: deque[tuple[float, Frame]] = deque()
        # When a free-running camera begins its next exposure.
        self._next = clock.now()

    def _exposure_range(self) -> tuple[float, float]:
        return HARDWARE.shortest, HARDWARE.longest

    def _read_exposure(self) -> float:
        self._check_open()
        return self._exposure

    def _write_exposure(self, seconds: float) -> None:
        self._run_until(self._clock.now())
        self._exposure = round(seconds / 1e-6) * 1e-6

    def get_image(self, timeout: float) -> Frame:
        deadline = self._clock.now() + timeout
        while True:
            self._check_open()
            self._run_until(self._clock.now())
            soon = math.inf
            if self._waiting:
                soon = self._waiting[0][0]
                if soon <= self._clock.now():
                    return self._waiting.popleft()[1]
            elif self._settings.fps:
                soon = self._next + self._exposure + HARDWARE.latency
            if soon > deadline:
                self._clock.sleep(deadline - self._clock.now())
                raise self._timeout(timeout, "check the camera's cable and trigger")
            self._clock.sleep(soon - self._clock.now())

    def flush(self) -> None:
        self._check_open()
        now = self._clock.now()
        self._run_until(now)
        self._waiting = deque(item for item in self._waiting if item[0] > now)

    def trigger(self) -> None:
        self._check_open()
        if not self._settings.fps:
            self._take(self._clock.now() + HARDWARE.trigger_delay)

    def reopen(self) -> "VirtualCamera":
        """The camera after it was closed or lost, without its frames."""
        self._closed = False
        self._waiting.clear()
        self._next = max(self._next, self._clock.now())
        return self

    def _run_until(self, now: float) -> None:
        """Take the frames of a free-running camera whose exposure has ended."""
        while self._settings.fps and self._next + self._exposure <= now:
            if len(self._waiting) < HARDWARE.buffers:
                self._take(self._next)
            else:
                self._id += 1
            # The next exposure cannot begin during the read-out.
            self._next += max(1 / self._settings.fps, self._exposure + HARDWARE.latency)

    def _take(self, start: float) -> None:
        number, self._id = self._id, self._id + 1
        stop = start + self._exposure
        self._keep(Frame(self._expose(start, stop, number), stop, self._sensor.clip_level))

    def _keep(self, frame: Frame) -> None:
        self._waiting.append((frame.timestamp + HARDWARE.latency, frame))

    def _expose(self, start: float, stop: float, number: int) -> NDArray[Any]:
        light = self._light.between(start, stop)
        sensor = replace(self._sensor, exposure=(stop - start) / self._settings.unit)
        raw = sensor.expose(light[:, None], seed=self._settings.seed, first_frame=number)
        if self._settings.camera_gamma != 1:
            top = sensor.clip_level
            raw = np.rint((raw / top) ** (1 / self._settings.camera_gamma) * top).astype(raw.dtype)
        return np.ascontiguousarray(raw.reshape(self._light.truth.camera_shape))
