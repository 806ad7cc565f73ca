"""A virtual projector: images appear some refreshes late, and sometimes later still."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError
from lightmatrix.live.devices.clock import Clock
from lightmatrix.live.devices.protocols import check_image
from lightmatrix.live.devices.virtual.light import Light
from lightmatrix.live.devices.virtual.settings import VirtualSettings

# A late image is late by 3 to 8 refreshes.
_LATE = (3, 8)
# The fault of an image is drawn from the seed, this number and the image's number. The camera has
# another number, so that faults of both are independent.
_STREAM = 1


class VirtualProjector:
    """The projector of a virtual rig; it changes the light that the camera photographs."""

    def __init__(self, light: Light, settings: VirtualSettings, clock: Clock) -> None:
        self._light, self._settings, self._clock = light, settings, clock
        self._count = 0
        # The image that was asked for last; None once the projector is closed.
        self.image: NDArray[np.uint8] | None = np.zeros(self.shape, np.uint8)

    @property
    def shape(self) -> tuple[int, int]:
        return self._light.truth.projector_shape

    def info(self) -> dict[str, Any]:
        return {
            "name": f"virtual:{self._settings.scene}",
            "shape": list(self.shape),
            "refresh": self._settings.refresh,
        }

    def show(self, image: NDArray[np.uint8]) -> float:
        if self.image is None:
            raise DeviceError("the virtual projector is closed", hint="open it again")
        check_image(image, self.shape)
        self.image = image
        if image.ndim == 3:
            image = image.mean(axis=2).astype(np.uint8)
        refresh = 1 / self._settings.refresh
        now = self._clock.now()
        # Like a window that swaps its buffers, it returns at the next refresh.
        swap = math.ceil(now / refresh) * refresh
        self._clock.sleep(swap - now)
        lateness = 0
        draw = np.random.default_rng([self._settings.seed, _STREAM, self._count])
        if draw.random() < self._settings.late:
            lateness = int(draw.integers(*_LATE, endpoint=True))
        self._count += 1
        self._light.change(swap + (self._settings.delay + lateness) * refresh, image)
        return self._clock.now()

    def black(self) -> float:
        return self.show(np.zeros(self.shape, np.uint8))

    def close(self) -> None:
        self.image = None
