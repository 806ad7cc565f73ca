"""The camera's linearity: twice the exposure, twice the level above black."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.frames.repeats import take_steady
from lightmatrix.live.measurements.white import Whites, find_white, images
from lightmatrix.live.rig import Rig

_STEPS = 7
_SHORTEST = 1 / 16
# Deviations that make estimates wrong in the first digit that counts.
TOLERATED = 0.02


@dataclass(frozen=True)
class CameraLinearity:
    """Levels of a white picture at several exposures; of a camera that has one, nothing is known.

    Parameters
    ----------
    exposures : tuple of float
        Seconds, from the shortest to the longest.
    levels : tuple of float
        Mean level above black of the lit samples, as a share of the clip level.
    deviation : float
        The largest distance of a level from the straight line, as a share of the longest one's.
    exponent : float
        Of the power of the exposure that comes nearest; 1 is linear.
    """

    exposures: tuple[float, ...]
    levels: tuple[float, ...]
    deviation: float
    exponent: float

    @property
    def linear(self) -> bool:
        """Whether it may be taken for linear: to 2 % of the brightest level."""
        return self.deviation <= TOLERATED


def measure_linearity(
    rig: Rig,
    *,
    settle: float,
    period: float = 0.0,
    whites: Whites | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CameraLinearity:
    """Photograph white and black at several exposures.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    period : float
        Of a flicker, seconds; 0 for none. With one, more frames are taken of each.
    whites : Whites, optional
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
    taker = Taker(rig, settle)
    whites = whites or find_white(taker)
    black, white = images(rig)
    asked = whites.exposure * np.geomspace(_SHORTEST, 1, _STEPS)
    # Frames at all moments of a flicker see the same light together.
    count = 12 if period else 3
    shortest, longest = exposure_limits(rig.camera)
    asked = np.unique(asked.clip(shortest, longest))
    exposures, levels = [], []
    for k, exposure in enumerate(asked):
        bright = take_steady(taker, white, float(exposure), count)
        dark = take_steady(taker, black, float(exposure), count)
        exposures.append(bright.exposure)
        levels.append(float((bright.mean - dark.mean)[whites.lit].mean() / bright.clip_level))
        if progress is not None:
            progress(k + 1, len(asked))
    times, light = np.array(exposures), np.array(levels)
    # Through zero and the brightest level: what is written down as twice the light has to be.
    straight = light[-1] * times / times[-1]
    deviation = float(np.abs(light - straight).max() / light[-1])
    ratio = np.log(times / times[-1])
    bent = np.log(np.maximum(light, 1e-6) / light[-1])
    weight = light / light[-1]
    power = float((weight * ratio * ratio).sum())
    exponent = float((weight * ratio * bent).sum()) / power if power else 1.0
    return CameraLinearity(tuple(exposures), tuple(levels), deviation, exponent)
