"""The exposures of a capture, advised by the planner from a white frame of the rig."""
# MERGED DOCS
# """The projector's response: how much light it gives for each grey value."""
# """The camera's linearity: whether twice the exposure gives twice the level above black."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lightmatrix.live.devices.base import exposure_limits
from lightmatrix.live.photograph import (
    Photographer,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
    take_average,
)
from lightmatrix.live.rig import Rig
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.planning.exposure_advice import (
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
)

# A warning says that the camera cannot expose as advised if its limit is off by this factor, one
# stop. Chosen by hand.
_FAR_OFF = 2.0
# A warning says that avoiding flicker makes more samples clip if the exposure grows by this factor.
# Chosen by hand: a smaller change is within the tolerance of the advice.
_LONGER = 1.2
# A pixel of the mean of several white frames counts as clipped from this share of the clip level
# on. Chosen by hand: noise takes the mean of clipped frames slightly below the level.
_CLIPS = 0.995
# A black frame at this share of the white frame's exposure separates the room's light from the
# pedestal. A camera whose shortest exposure is more than the second share of it cannot do that.
# Chosen by hand.
_BRIEF, _NOT_BRIEF = 1 / 8, 0.6


@dataclass(frozen=True)
class ExposureAdvice:
    """How to expose a rig's frames."""

    # From the longest to the shortest, in equal shares of the frames.
    seconds: tuple[float, ...]
    # Share of projector pixels to light in random patterns.
    density: float
    # Share of the samples that will clip at each exposure.
    clipped: tuple[float, ...]
    # Standard deviation of a sample, as a share of the clip level.
    noise: float
    # Raw level without any light.
    pedestal: float
    # Seconds that each exposure is a multiple of, where something flickers; 0 for none.
    period: float = 0.0
    # What the camera cannot do.
    warnings: tuple[str, ...] = field(default=())


def measure_exposure(
    rig: Rig, *, settle: float, period: float = 0.0, whites: WhiteAndBlack | None = None
) -> ExposureAdvice:
    """Advise the exposures of a rig from a white picture, as `plan` does from a photograph.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    period : float
        Seconds that exposures should be a multiple of; see `measure_flicker`.
    whites : WhiteAndBlack, optional
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
    photographer = Photographer(rig, settle)
    whites = whites or find_white_and_black(photographer)
    limits = exposure_limits(rig.camera)
    top = whites.white.clip_level
    pedestal = _pedestal(photographer, whites, limits[0])
    levels = whites.light.ravel().astype(np.float64) / (top - pedestal) / whites.exposure
    clipped = (whites.white.mean >= _CLIPS * top).ravel()
    frame = WhiteFrame(levels, clipped)
    noise = max(whites.white.noise, whites.black.noise) / top
    advised = advise_exposures(frame, noise)
    possible, warnings = [], []
    for exposure, _ in advised:
        seconds, concerns = _possible(exposure, period, limits)
        possible.append(seconds)
        warnings += concerns
    seconds_used = tuple(sorted(set(possible), reverse=True))
    return ExposureAdvice(
        seconds_used,
        advise_density(frame, advised),
        tuple(clipped_share(frame, exposure) for exposure in seconds_used),
        noise,
        pedestal,
        period,
        tuple(warnings),
    )


def _possible(
    exposure: float, period: float, limits: tuple[float, float]
) -> tuple[float, list[str]]:
    """The exposure nearest to an advised one that does not flicker and that the camera has."""
    shortest, longest = limits
    warnings = []
    steady = exposure
    if period:
        steady = max(1, math.floor(exposure / period + 1e-6)) * period
        if steady > _LONGER * exposure:
            warnings.append(
                f"an exposure of {exposure:.3g} s would flicker; {steady:.3g} s clips more: "
                "close the aperture"
            )
    if steady > _FAR_OFF * longest:
        warnings.append(f"the camera exposes for {longest:g} s at most, not {steady:.3g} s")
    if _FAR_OFF * steady < shortest:
        warnings.append(
            f"the camera exposes for {shortest:g} s at least, not {steady:.3g} s: close the "
            "aperture"
        )
    return min(max(steady, shortest), longest), warnings


def _pedestal(photographer: Photographer, whites: WhiteAndBlack, shortest: float) -> float:
    """The level without any light: that of black frames without the room's light."""
    black = whites.black.without_noise
    brief = max(shortest, _BRIEF * whites.exposure)
    if brief > _NOT_BRIEF * whites.exposure:
        return float(np.median(black))
    dark = take_average(photographer, plain_images(photographer.rig)[0], brief, 3)
    share = dark.exposure / whites.exposure
    level = (dark.without_noise - share * black) / (1 - share)
    return max(0.0, float(np.median(level)))


# Grey values that are photographed, evenly from 0 to 255: a smooth curve is known between them.
_STEPS = 17


def measure_response(
    rig: Rig,
    *,
    settle: float,
    whites: WhiteAndBlack | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    whites : WhiteAndBlack, optional
        White and black frame, if they are known already.
    progress : callable, optional
        Called with (done, total) grey values.

    Returns
    -------
    ProjectorResponse

    Raises
    ------
    DeviceError
        If the camera does not see the projector.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,gamma=2.2,real=0") as rig:
    ...     response = lm.measure_response(rig, settle=0.05)
    >>> round(response.gamma, 1), int(response.grey_for(np.array([0.5]))[0])
    (2.2, 186)
    """
    photographer = Photographer(rig, settle)
    whites = whites or find_white_and_black(photographer)
    levels = np.rint(np.linspace(0, 255, _STEPS)).astype(int)
    light = np.empty(_STEPS)
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        light[k] = whites.level(take_average(photographer, image, whites.exposure, 3).mean)
        if progress is not None:
            progress(k + 1, _STEPS)
    return ProjectorResponse.of_light(levels, light)


# Exposures from this share of the longest one up to it, and their number: each is 1.6 times the one
# before, from the noise up to the brightest level.
_SHORTEST, _EXPOSURES = 1 / 16, 7
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
    asked = whites.exposure * np.geomspace(_SHORTEST, 1, _EXPOSURES)
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
