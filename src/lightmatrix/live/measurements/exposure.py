"""The exposures of a capture: by the planner, from a white picture of the rig."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.frames.repeats import take_steady
from lightmatrix.live.measurements.white import Whites, find_white, images
from lightmatrix.live.rig import Rig
from lightmatrix.planning.advice import (
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
)

# A camera that cannot expose as advised is told of beyond this factor.
_BEYOND = 2.0


@dataclass(frozen=True)
class ExposureAdvice:
    """What to expose a rig's frames with.

    Parameters
    ----------
    seconds : tuple of float
        From the longest to the shortest, in equal shares of the frames.
    density : float
        Share of projector pixels to light in random patterns.
    clipped : tuple of float
        Share of the samples that will clip at each exposure.
    noise : float
        Standard deviation of a sample, as a share of the clip level.
    pedestal : float
        Raw level without any light.
    period : float
        Seconds that each exposure is a multiple of, where something flickers; 0 for none.
    warnings : tuple of str
        What could not be had.
    """

    seconds: tuple[float, ...]
    density: float
    clipped: tuple[float, ...]
    noise: float
    pedestal: float
    period: float = 0.0
    warnings: tuple[str, ...] = field(default=())


def measure_exposure(
    rig: Rig, *, settle: float, period: float = 0.0, whites: Whites | None = None
) -> ExposureAdvice:
    """Advise the exposures of a rig from a white picture, as `plan` does from a photograph.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    period : float
        Seconds that exposures should be a multiple of; see `measure_flicker`.
    whites : Whites, optional
        White and black frame, if they are known already.

    Returns
    -------
    ExposureAdvice

    Raises
    ------
    DeviceError
        If the camera does not see the projector, or all clips.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
    ...     advice = lm.measure_exposure(rig, settle=0.05)
    >>> len(advice.seconds), 60 < advice.pedestal < 68
    (1, True)
    """
    taker = Taker(rig, settle)
    whites = whites or find_white(taker)
    shortest, longest = exposure_limits(rig.camera)
    top = whites.white.clip_level
    pedestal = _pedestal(taker, whites, shortest)
    levels = whites.light.ravel().astype(np.float64) / (top - pedestal) / whites.exposure
    clipped = (whites.white.mean >= 0.995 * top).ravel()
    frame = WhiteFrame(levels, clipped)
    noise = max(whites.white.noise, whites.black.noise) / top
    advised = advise_exposures(frame, noise)
    warnings = []
    seconds = []
    for exposure, _ in advised:
        fitting = exposure
        if period:
            fitting = max(1, math.floor(exposure / period + 1e-6)) * period
            if fitting > 1.2 * exposure:
                warnings.append(
                    f"an exposure of {exposure:.3g} s would flicker; {fitting:.3g} s clips more: "
                    "close the aperture"
                )
        if fitting > _BEYOND * longest:
            warnings.append(f"the camera exposes for {longest:g} s at most, not {fitting:.3g} s")
        if _BEYOND * fitting < shortest:
            warnings.append(
                f"the camera exposes for {shortest:g} s at least, not {fitting:.3g} s: close the "
                "aperture"
            )
        seconds.append(min(max(fitting, shortest), longest))
    kept = tuple(sorted(set(seconds), reverse=True))
    return ExposureAdvice(
        kept,
        advise_density(frame, advised),
        tuple(clipped_share(frame, exposure) for exposure in kept),
        noise,
        pedestal,
        period,
        tuple(warnings),
    )


def _pedestal(taker: Taker, whites: Whites, shortest: float) -> float:
    """The black level: what is left of a black frame once the room's light is taken off."""
    from_room = whites.black
    brief = max(shortest, whites.exposure / 8)
    if brief > 0.6 * whites.exposure:
        return float(np.median(from_room.without_noise))
    dark = take_steady(taker, images(taker.rig)[0], brief, 3)
    share = dark.exposure / whites.exposure
    level = (dark.without_noise - share * from_room.without_noise) / (1 - share)
    return max(0.0, float(np.median(level)))
