"""A white and a black frame at an exposure at which white is bright and does not clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.white_share import lit_samples, share_of_white
from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Photographer
from lightmatrix.live.frames.repeats import AveragedFrame, take_average
from lightmatrix.live.rig import Rig, UnfitRigError

# Seconds to wait after showing an image while the settle time is not known. Chosen by hand: no
# projector that we know of takes longer.
FIRST_SETTLE = 0.4
# Bright samples of a good white frame are between the last two shares of the clip level; the first
# is the one to aim at. Chosen by hand: bright, and away from clipping if the light flickers.
_WANTED, _FEWEST, _MOST = 0.7, 0.35, 0.9
# The brightness of a frame is this quantile of its samples, so that single glints do not count.
_BRIGHT = 0.99
# White has to be above black by this share of the clip level, or it is not the projector's light.
_VISIBLE = 0.02
# Exposures that are tried before the search is given up; the whole range of a camera, 1 to 10^6,
# takes 7 steps.
_TRIES = 12
# Factor from one exposure to the next if nearly nothing is seen, or if nearly all clips.
_STEP = 8.0


@dataclass(frozen=True, eq=False)
class WhiteAndBlack:
    """A white and a black frame of one exposure."""

    white: AveragedFrame
    black: AveragedFrame

    @property
    def exposure(self) -> float:
        """Seconds."""
        return self.white.exposure

    @property
    def light(self) -> NDArray[np.float32]:
        """White less black, raw levels."""
        return np.asarray(self.white.mean - self.black.mean)

    @property
    def brightness(self) -> float:
        """Mean light per second of exposure, as a share of the clip level."""
        return float(self.light.mean()) / self.white.clip_level / self.exposure

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Samples that the projector lights well and that do not clip."""
        return lit_samples(self.white.mean, self.black.mean, self.white.clip_level)

    def level(self, frame: NDArray[np.generic]) -> float:
        """How far a frame is from black (0) to white (1), over the lit samples."""
        return share_of_white(frame, self.white.mean, self.black.mean, self.lit)


def plain_images(rig: Rig) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The black and the white image of a rig's projector."""
    black = np.zeros(rig.projector.shape, np.uint8)
    return black, np.full_like(black, 255)


def take_white_and_black(
    photographer: Photographer, exposure: float, count: int = 3
) -> WhiteAndBlack:
    """Photograph white, then black, `count` times each at an exposure in seconds."""
    black, white = plain_images(photographer.rig)
    return WhiteAndBlack(
        take_average(photographer, white, exposure, count),
        take_average(photographer, black, exposure, count),
    )


def find_white_and_black(photographer: Photographer) -> WhiteAndBlack:
    """Photograph white and black at an exposure chosen for white, or raise an UnfitRigError."""
    shortest, longest = exposure_limits(photographer.rig.camera)
    exposure = float(np.clip(photographer.rig.camera.exposure, shortest, longest))
    for _ in range(_TRIES):
        pair = take_white_and_black(photographer, exposure)
        top = pair.white.clip_level
        level = float(np.quantile(pair.white.mean, _BRIGHT))
        pedestal = float(np.median(pair.black.mean))
        share = (level - pedestal) / max(top - pedestal, 1.0)
        if pedestal > _MOST * top:
            # The room alone makes the camera clip.
            share = 1.0
        # If white hardly differs from black, it is lit by the room or not at all.
        visible = float(np.quantile(pair.light, _BRIGHT)) / top > _VISIBLE
        at_shortest, at_longest = exposure <= 1.01 * shortest, exposure >= 0.99 * longest
        if (
            _FEWEST <= share <= _MOST
            or (at_longest and visible)
            or (at_shortest and share <= _MOST)
        ):
            if visible:
                return pair
            break
        factor = 1 / _STEP if share > _MOST else min(_STEP, _WANTED / max(share, 1e-3))
        if (factor < 1 and at_shortest) or (factor > 1 and at_longest):
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
