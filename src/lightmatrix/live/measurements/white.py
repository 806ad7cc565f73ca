"""An exposure at which a white picture is bright and does not clip, to measure the rest with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.white_share import lit_samples, share_of_white
from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.frames.repeats import Steady, take_steady
from lightmatrix.live.rig import Rig, UnfitRigError

# Before anything is known: nothing that shows pictures takes longer to show one.
FIRST_SETTLE = 0.4
# The clip level's share that bright samples should reach, and what is bright enough.
_WANTED, _FEWEST, _MOST = 0.7, 0.35, 0.9
# Bright samples, but not single glints.
_BRIGHT = 0.99
# Of the clip level: white that is above black by less is not the projector's.
_SEEN = 0.02
_TRIES = 12
# From one try to the next where hardly anything, or nearly all, is seen.
_STEP = 8.0


@dataclass(frozen=True, eq=False)
class Whites:
    """A white and a black frame of one exposure.

    Parameters
    ----------
    white, black : Steady
    """

    white: Steady
    black: Steady

    @property
    def exposure(self) -> float:
        """Seconds."""
        return self.white.exposure

    @property
    def light(self) -> NDArray[np.float32]:
        """White less black, raw levels."""
        return np.asarray(self.white.mean - self.black.mean)

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Samples that the projector lights well and that do not clip."""
        return lit_samples(self.white.mean, self.black.mean, self.white.clip_level)

    def level(self, frame: NDArray[np.generic]) -> float:
        """How far a frame is from black (0) to white (1), over the samples that are lit."""
        return share_of_white(frame, self.white.mean, self.black.mean, self.lit)


def images(rig: Rig) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The black and the white image of a rig's projector."""
    black = np.zeros(rig.projector.shape, np.uint8)
    return black, np.full_like(black, 255)


def find_white(taker: Taker, count: int = 3) -> Whites:
    """Choose an exposure for white, and photograph white and black at it.

    Parameters
    ----------
    taker : Taker
    count : int
        Frames of each.

    Raises
    ------
    DeviceError
        If the camera sees no light of the projector, or all clips even at its shortest exposure.
    """
    black, white = images(taker.rig)
    shortest, longest = exposure_limits(taker.rig.camera)
    exposure = float(np.clip(taker.rig.camera.exposure, shortest, longest))
    for _ in range(_TRIES):
        bright = take_steady(taker, white, exposure, count)
        dark = take_steady(taker, black, exposure, count)
        found = Whites(bright, dark)
        level = float(np.quantile(bright.mean, _BRIGHT))
        pedestal = float(np.median(dark.mean))
        # A room that is too bright clips black as well.
        share = (level - pedestal) / max(bright.clip_level - pedestal, 1.0)
        if pedestal > _MOST * bright.clip_level:
            share = 1.0
        # White that hardly differs from black has the room's light, or none at all.
        seen = float(np.quantile(found.light, _BRIGHT)) / bright.clip_level
        ends = exposure <= 1.01 * shortest, exposure >= 0.99 * longest
        if _FEWEST <= share <= _MOST or (ends[1] and seen > _SEEN) or (ends[0] and share <= _MOST):
            if seen > _SEEN:
                return found
            break
        factor = 1 / _STEP if share > _MOST else min(_STEP, _WANTED / max(share, 1e-3))
        if (factor < 1 and ends[0]) or (factor > 1 and ends[1]):
            break
        exposure = float(np.clip(exposure * factor, shortest, longest))
    if share > _MOST and exposure <= 1.01 * shortest:
        raise UnfitRigError(
            f"the white picture clips even at the camera's shortest exposure, {exposure:g} s",
            hint="close the camera's aperture, lower its gain, or dim the projector",
        )
    raise UnfitRigError(
        "the camera does not see the projector: a white picture looks like a black one",
        hint="is the projector on, its lens uncovered, the picture on the right monitor, and the "
        "camera pointed at it? A picture that comes half a second late is not seen either",
    )
