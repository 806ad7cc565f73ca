"""The light in a virtual rig over time, from the projector and from the room."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.devices.virtual.settings import VirtualSettings
from lightmatrix.simulation.truth import Truth

# Seconds for which earlier images are remembered: frames may begin that long ago. Exposures last
# at most 10 s.
_REMEMBERED = 10.0


@dataclass(eq=False)
class Light:
    """Irradiance of the camera's M samples."""

    # T, including the blur of the projector.
    truth: Truth
    # (M,): irradiance by the room's light.
    room: NDArray[np.float32]
    settings: VirtualSettings
    # When the lamp had its full brightness.
    begun: float = 0.0
    # Times from which on the projector gave an irradiance, in ascending order.
    _shown: deque[tuple[float, NDArray[np.float32]]] = field(default_factory=deque)

    def __post_init__(self) -> None:
        black = np.zeros(self.truth.projector_shape, np.uint8)
        self._shown.append((-math.inf, self.irradiance(black)))

    def irradiance(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """T p (M,) of an image (rows, cols) uint8, with the projector's gamma and leaking black."""
        leak = self.settings.leak
        emitted = leak + (1 - leak) * (image.ravel() / 255.0) ** self.settings.gamma
        return np.asarray(self.truth.matrix @ emitted.astype(np.float32), np.float32)

    def change(self, when: float, image: NDArray[np.uint8]) -> None:
        """Show an image from some time on."""
        while self._shown and self._shown[-1][0] >= when:
            # The next image overtakes one that is late.
            self._shown.pop()
        self._shown.append((when, self.irradiance(image)))

    def between(self, start: float, stop: float) -> NDArray[np.float32]:
        """Mean irradiance (M,) between two times."""
        while len(self._shown) > 1 and self._shown[1][0] < start - _REMEMBERED:
            self._shown.popleft()
        total = np.zeros(len(self.room), np.float64)
        ends = [since for since, _ in list(self._shown)[1:]] + [math.inf]
        for (since, irradiance), end in zip(self._shown, ends, strict=True):
            first, last = max(start, since), min(stop, end)
            if last > first:
                total += self._lamp(first, last) * irradiance
        total += self._flickering(start, stop, self.settings.room_flicker) * self.room
        return np.asarray(total / (stop - start), np.float32)

    def _lamp(self, start: float, stop: float) -> float:
        """Light of the lamp between two times; without flicker and fading 1 a second."""
        light = self._flickering(start, stop, self.settings.flicker)
        if self.settings.fading:
            minutes = (0.5 * (start + stop) - self.begun) / 60
            light *= (1 - self.settings.fading) ** max(0.0, minutes)
        return light

    def _flickering(self, start: float, stop: float, amplitude: float) -> float:
        """Light of 1 a second between two times, if it flickers by an amplitude."""
        angular = 2 * math.pi * self.settings.flicker_hz
        if not amplitude or not angular:
            return stop - start
        waves = (math.cos(angular * start) - math.cos(angular * stop)) / angular
        return stop - start + amplitude * waves
