"""The camera's linearity: whether twice the exposure gives twice the level above black."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Photographer
from lightmatrix.live.frames.repeats import take_average
from lightmatrix.live.measurements.white_and_black import (
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
)
from lightmatrix.live.rig import Rig

# Exposures from this share of the longest one up to it, and their number: each is 1.6 times the one
# before, from the noise up to the brightest level.
_SHORTEST, _STEPS = 1 / 16, 7
# Frames of each image at each exposure, without and with flicker. Twelve frames at random moments
# of a flicker average it out.
_FRAMES, _FLICKERING_FRAMES = 3, 12
# A camera is linear if no level deviates by more than this share of the brightest one. Larger
# deviations change the second digit of estimates.
TOLERATED = 0.02


@dataclass(frozen=True)
class CameraLinearity:
    """Levels of a white picture at several exposures; one exposure alone counts as linear."""

    # Seconds, from the shortest to the longest.
    exposures: tuple[float, ...]
    # Mean level above black of the lit samples, as a share of the clip level.
    levels: tuple[float, ...]
    # The largest distance of a level from the straight line, as a share of the longest one's.
    deviation: float
    # Exponent of the power law that fits best; 1 is linear.
    exponent: float

    @property
    def linear(self) -> bool:
        """Whether the deviation is at most 2 % of the brightest level."""
        return self.deviation <= TOLERATED


def measure_linearity(
    rig: Rig,
    *,
    settle: float,
    period: float = 0.0,
    whites: WhiteAndBlack | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CameraLinearity:
    """Photograph white and black at several exposures.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    period : float
        Period of a flicker in seconds; 0 for none. With one, more frames are taken of each.
    whites : WhiteAndBlack, optional
        White and black frame, if they are known already.
    progress : callable, optional
        Called with (done, total) exposures.

    Returns
    -------
    CameraLinearity

    Raises
    ------
    DeviceError
        If the camera does not see the projector.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
    ...     lm.measure_linearity(rig, settle=0.05).linear
    True
    """
    photographer = Photographer(rig, settle)
    whites = whites or find_white_and_black(photographer)
    black, white = plain_images(rig)
    asked = whites.exposure * np.geomspace(_SHORTEST, 1, _STEPS)
    count = _FLICKERING_FRAMES if period else _FRAMES
    shortest, longest = exposure_limits(rig.camera)
    asked = np.unique(asked.clip(shortest, longest))
    exposures, levels = [], []
    for k, exposure in enumerate(asked):
        bright = take_average(photographer, white, float(exposure), count)
        dark = take_average(photographer, black, float(exposure), count)
        exposures.append(bright.exposure)
        levels.append(float((bright.mean - dark.mean)[whites.lit].mean() / bright.clip_level))
        if progress is not None:
            progress(k + 1, len(asked))
    times, light = np.array(exposures), np.array(levels)
    # The straight line goes through zero and the brightest level.
    straight = light[-1] * times / times[-1]
    deviation = float(np.abs(light - straight).max() / light[-1])
    log_time = np.log(times / times[-1])
    log_light = np.log(np.maximum(light, 1e-6) / light[-1])
    weight = light / light[-1]
    power = float((weight * log_time * log_time).sum())
    exponent = float((weight * log_time * log_light).sum()) / power if power else 1.0
    return CameraLinearity(tuple(exposures), tuple(levels), deviation, exponent)
