"""A virtual camera with faults: free-running, with buffers that grow stale, or triggered."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.sensor import Sensor
from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.clock import Clock
from lightmatrix.live.devices.protocols import Frame
from lightmatrix.live.devices.virtual.light import Light
from lightmatrix.live.devices.virtual.settings import VirtualSettings

# The fault of a frame is drawn from the seed, this number and the frame's number.
_STREAM = 2
# Exposures in seconds: cameras count in microseconds, and have limits like these.
_STEP = 1e-6
_SHORTEST, _LONGEST = 20e-6, 10.0
# Seconds from the trigger to the start of the exposure, as of machine vision cameras.
_TRIGGER_DELAY = 1e-4


class _Waiting(NamedTuple):
    """A frame that was taken, and when it is ready."""

    ready: float
    frame: Frame


class VirtualCamera:
    """The camera of a virtual rig; it photographs the light that the projector changes."""

    def __init__(self, light: Light, settings: VirtualSettings, clock: Clock) -> None:
        self._light, self._settings, self._clock = light, settings, clock
        self._sensor = Sensor(
            black_level=settings.black,
            read_noise=settings.noise,
            shot_noise=settings.shot,
            bits=settings.bits,
        )
        self._exposure = 0.5 * settings.unit
        self._id = 0
        self._waiting: deque[_Waiting] = deque()
        self._last: NDArray[Any] | None = None
        self._begun = clock.now()
        self._next = self._begun
        self._meddled = settings.meddled == 0
        self._closed = False

    @property
    def exposure(self) -> float:
        self._check_plugged()
        self._meddle()
        return self._exposure

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        self._check_plugged()
        if not _SHORTEST <= seconds <= _LONGEST:
            raise InputError(
                f"the virtual camera has no exposure of {seconds} s",
                hint=f"use {_SHORTEST:g} to {_LONGEST:g} s",
            )
        self._run_until(self._clock.now())
        self._exposure = round(seconds / _STEP) * _STEP

    def info(self) -> dict[str, Any]:
        return {
            "name": f"virtual:{self._settings.scene}",
            "shape": list(self._light.truth.camera_shape),
            "bits": self._settings.bits,
            "shortest_exposure": _SHORTEST,
            "longest_exposure": _LONGEST,
        }

    def get_image(self, timeout: float) -> Frame:
        self._check_plugged()
        deadline = self._clock.now() + timeout
        while True:
            self._run_until(self._clock.now())
            if self._waiting and self._waiting[0].ready <= self._clock.now():
                return self._waiting.popleft().frame
            soon = self._waiting[0].ready if self._waiting else self._next_ready
            if soon > deadline:
                self._clock.sleep(deadline - self._clock.now())
                raise FrameTimeoutError(
                    f"no frame within {timeout:g} s", hint="check the camera's cable and trigger"
                )
            self._clock.sleep(soon - self._clock.now())
            self._check_plugged()

    def flush(self) -> None:
        self._check_plugged()
        self._run_until(self._clock.now())
        now = self._clock.now()
        self._waiting = deque(item for item in self._waiting if item.ready > now)

    def trigger(self) -> None:
        self._check_plugged()
        if not self._settings.fps:
            self._take(self._clock.now() + _TRIGGER_DELAY)

    def close(self) -> None:
        self._waiting.clear()
        self._closed = True

    def reopen(self) -> VirtualCamera:
        """The camera after it was lost, without its frames; a DeviceError while it is unplugged."""
        self._check_there()
        self._closed = False
        self._waiting.clear()
        self._next = max(self._next, self._clock.now())
        return self

    @property
    def _interval(self) -> float:
        # The next exposure cannot begin during the read-out.
        return max(self._settings.frame_interval, self._exposure + self._settings.latency)

    @property
    def _next_ready(self) -> float:
        if not self._settings.fps:
            return math.inf
        return self._next + self._exposure + self._settings.latency

    def _run_until(self, now: float) -> None:
        """Take the frames of a free-running camera whose exposure has ended."""
        self._meddle()
        while self._settings.fps and self._next + self._exposure <= now:
            if len(self._waiting) < self._settings.buffers:
                self._take(self._next)
            else:
                self._id += 1
            self._next += self._interval

    def _take(self, start: float) -> None:
        """Take one frame, perhaps with a fault."""
        number, self._id = self._id, self._id + 1
        stop = start + self._exposure
        draw = np.random.default_rng([self._settings.seed, _STREAM, number])
        fate = draw.random()
        data = self._expose(start, stop, number)
        before, self._last = self._last, data
        dropped, duplicate, torn = (
            self._settings.dropped, self._settings.duplicate, self._settings.torn,
        )  # fmt: skip
        if fate < dropped:
            return
        if before is not None and fate < dropped + duplicate:
            # Some drivers hand out the old buffer under a new number, others under its own.
            data = before
            number -= int(draw.integers(2))
        elif before is not None and fate < dropped + duplicate + torn:
            row = int(draw.integers(1, len(data)))
            data = np.concatenate([data[:row], before[row:]])
        ready = stop + self._settings.latency
        frame = Frame(data, number, stop, self._sensor.clip_level)
        self._waiting.append(_Waiting(ready, frame))

    def _expose(self, start: float, stop: float, number: int) -> NDArray[Any]:
        light = self._light.between(start, stop)
        sensor = replace(self._sensor, exposure=(stop - start) / self._settings.unit)
        raw = sensor.expose(light[:, None], seed=self._settings.seed, first_frame=number)
        if self._settings.curve != 1:
            black, top = sensor.black_level, sensor.clip_level
            share = np.clip((raw - black) / (top - black), 0, 1)
            raw = np.rint(black + share**self._settings.curve * (top - black)).astype(raw.dtype)
        return np.ascontiguousarray(raw.reshape(self._light.truth.camera_shape))

    def _meddle(self) -> None:
        """Let another program change the exposure, once."""
        settings = self._settings
        if not self._meddled and self._clock.now() - self._begun >= settings.meddled_at:
            self._meddled = True
            self._exposure *= settings.meddled

    def _check_plugged(self) -> None:
        if self._closed:
            raise DeviceError("the virtual camera is closed", hint="open it again")
        self._check_there()

    def _check_there(self) -> None:
        since = self._clock.now() - self._begun - self._settings.unplugged_at
        if self._settings.unplugged and 0 <= since < self._settings.unplugged:
            raise DeviceError(
                f"the camera virtual:{self._settings.scene} is gone",
                hint="plug it in again",
            )
