"""Virtual rigs that fail as real ones do: late images, lost and torn frames, flicker and more."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError
from lightmatrix.rig.devices.base import Clock, Frame
from lightmatrix.rig.devices.virtual import (
    HARDWARE,
    VirtualCamera,
    VirtualLight,
    VirtualProjector,
    VirtualSettings,
    parse_settings,
)
from lightmatrix.rig.rig import Rig, open_rig

# The faults of a usual rig.
USUAL = ",late=0.02,dropped=0.02,duplicate=0.01,torn=0.01"


@dataclass(frozen=True)
class Faults:
    """What goes wrong with a virtual rig: seconds, and rates from 0 to 1."""

    # Rate of images that the projector shows three to eight refreshes late.
    late: float = 0.0
    # Rates of frames that are lost, replaced by the one before, or contain its lower rows.
    dropped: float = 0.0
    duplicate: float = 0.0
    torn: float = 0.0
    # Amplitudes of the flicker of the projector's lamp and of the room's light, as shares of it,
    # and their frequency.
    flicker: float = 0.0
    room_flicker: float = 0.0
    flicker_hz: float = 100.0
    # How long the camera is gone, and how long after the start that begins.
    unplugged: float = 0.0
    unplugged_at: float = 5.0
    # Factor by which another program changes the exposure, and when.
    altered: float = 1.0
    altered_at: float = 5.0


class FaultyLight(VirtualLight):
    """Light that flickers, and images that come late."""

    def __init__(self, light: VirtualLight, faults: Faults) -> None:
        super().__init__(light.truth, light.room, light.settings)
        self._faults, self._count = faults, 0

    def change(self, when: float, image: NDArray[np.uint8]) -> None:
        draw = np.random.default_rng([self.settings.seed, 1, self._count])
        self._count += 1
        lateness = 0
        if draw.random() < self._faults.late:
            lateness = int(draw.integers(3, 8, endpoint=True))
        super().change(when + lateness / HARDWARE.refresh, image)

    def between(self, start: float, stop: float) -> NDArray[np.float32]:
        total = np.zeros(len(self.room), np.float64)
        for first, last, irradiance in self.parts(start, stop):
            total += self._flickering(first, last, self._faults.flicker) * irradiance
        total += self._flickering(start, stop, self._faults.room_flicker) * self.room
        return np.asarray(total / (stop - start), np.float32)

    def _flickering(self, start: float, stop: float, amplitude: float) -> float:
        """Light of 1 a second between two times, if it flickers by an amplitude."""
        angular = 2 * math.pi * self._faults.flicker_hz
        waves = (math.cos(angular * start) - math.cos(angular * stop)) / angular
        return stop - start + amplitude * waves


class FaultyCamera(VirtualCamera):
    """A camera that loses and repeats frames, is unplugged, or is used by another program too."""

    def __init__(self, light: VirtualLight, clock: Clock, faults: Faults) -> None:
        super().__init__(light, clock)
        self._faults, self._begun = faults, clock.now()
        self._last: NDArray[Any] | None = None
        self._altered = False

    def reopen(self) -> VirtualCamera:
        self._check_there()
        return super().reopen()

    def _check_open(self) -> None:
        super()._check_open()
        self._check_there()
        if not self._altered and self._clock.now() - self._begun >= self._faults.altered_at:
            self._altered = True
            self._exposure *= self._faults.altered

    def _check_there(self) -> None:
        since = self._clock.now() - self._begun - self._faults.unplugged_at
        if 0 <= since < self._faults.unplugged:
            raise DeviceError("the virtual camera is gone", hint="plug it in again")

    def _keep(self, frame: Frame) -> None:
        faults = self._faults
        draw = np.random.default_rng([self._settings.seed, 2, self._id - 1])
        fate = draw.random()
        before, self._last = self._last, frame.data
        if fate < faults.dropped:
            return
        if before is not None and fate < faults.dropped + faults.duplicate:
            frame = replace(frame, data=before)
        elif before is not None and fate < faults.dropped + faults.duplicate + faults.torn:
            row = int(draw.integers(1, len(before)))
            frame = replace(frame, data=np.concatenate([frame.data[:row], before[row:]]))
        super()._keep(frame)


def faulty(settings: VirtualSettings, faults: Faults) -> Rig:
    """Open a virtual rig with faults."""
    rig = open_rig(settings)
    assert isinstance(rig.camera, VirtualCamera)
    light = FaultyLight(rig.camera._light, faults)
    camera = FaultyCamera(light, rig.clock, faults)
    projector = VirtualProjector(light, rig.clock)
    return replace(rig, projector=projector, camera=camera, reopen=camera.reopen)


def faulty_rig(text: str) -> Rig:
    """Open ``virtual:SCENE,name=value,...``: settings and faults, of which the last count."""
    names = [field.name for field in fields(Faults)]
    scene, *words = text.split(",")
    values = dict(word.split("=") for word in words)
    faults = Faults(**{name: float(value) for name, value in values.items() if name in names})
    plain = [f"{name}={value}" for name, value in values.items() if name not in names]
    return faulty(parse_settings(",".join([scene, *plain])), faults)


def levels_of(rig: Rig, image: NDArray[np.uint8], seconds: float) -> NDArray[np.float64]:
    """What a virtual rig's frame of an image contains without noise and faults, (M,) raw levels."""
    assert isinstance(rig.camera, VirtualCamera)
    light, settings = rig.camera._light, rig.camera._settings
    sample = (light.irradiance(image) + light.room) * seconds / settings.unit
    top = 2.0**settings.bits - 1
    return np.asarray(settings.black + np.minimum(sample, 1) * (top - settings.black))
