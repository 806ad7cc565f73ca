"""Exposures, the projector's response and the camera's linearity, by the light levels of a rig."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.planning.exposure_advice import (
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
)
from lightmatrix.rig.devices.base import exposure_limits
from lightmatrix.rig.photograph import (
    Photographer,
    WhiteAndBlack,
    plain_images,
    take_average,
)
from lightmatrix.rig.rig import Rig


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
    rig: Rig, whites: WhiteAndBlack, settle: float, period: float = 0.0
) -> ExposureAdvice:
    """Advise the exposures of a rig from a white picture, as `plan` does from a photograph.

    `settle` is in seconds, and `period` are those that exposures should be a multiple of. An
    InputError says that all clips.
    """
    photographer = Photographer(rig, settle)
    limits = exposure_limits(rig.camera)
    top = whites.white.clip_level
    pedestal = _pedestal(photographer, whites, limits[0])
    levels = whites.light.ravel().astype(np.float64) / (top - pedestal) / whites.exposure
    # Noise takes the mean of clipped frames slightly below the clip level.
    clipped = (whites.white.mean >= 0.995 * top).ravel()
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
    """The exposure nearest to an advised one that does not flicker and that the camera has.

    Warns where that is off by a stop, or by a fifth to avoid flicker: less is within the tolerance
    of the advice.
    """
    shortest, longest = limits
    warnings = []
    steady = exposure
    if period:
        steady = max(1, math.floor(exposure / period + 1e-6)) * period
        if steady > 1.2 * exposure:
            warnings.append(
                f"an exposure of {exposure:.3g} s would flicker; {steady:.3g} s clips more: "
                "close the aperture"
            )
    if steady > 2 * longest:
        warnings.append(f"the camera exposes for {longest:g} s at most, not {steady:.3g} s")
    if 2 * steady < shortest:
        warnings.append(
            f"the camera exposes for {shortest:g} s at least, not {steady:.3g} s: close the "
            "aperture"
        )
    return min(max(steady, shortest), longest), warnings


def _pedestal(photographer: Photographer, whites: WhiteAndBlack, shortest: float) -> float:
    """The level without any light: that of black frames without the room's light.

    A black frame at an eighth of the exposure separates both. A camera that cannot expose for so
    short a time gives the level of black frames.
    """
    black = whites.black.without_noise
    brief = max(shortest, whites.exposure / 8)
    if brief > 0.6 * whites.exposure:
        return float(np.median(black))
    dark = take_average(photographer, plain_images(photographer.rig)[0], brief, 3)
    share = dark.exposure / whites.exposure
    level = (dark.without_noise - share * black) / (1 - share)
    return max(0.0, float(np.median(level)))


def measure_response(
    rig: Rig,
    whites: WhiteAndBlack,
    settle: float,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value.

    `settle` is in seconds; `progress` is called with (done, total) grey values.
    """
    photographer = Photographer(rig, settle)
    # A smooth curve is known between 17 grey values.
    levels = np.rint(np.linspace(0, 255, 17)).astype(int)
    light = np.empty(len(levels))
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        light[k] = whites.level(take_average(photographer, image, whites.exposure, 3).mean)
        if progress is not None:
            progress(k + 1, len(levels))
    return ProjectorResponse.of_light(levels, light)


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
        """Whether the deviation is at most 2 % of the brightest level.

        Larger ones change the second digit of estimates.
        """
        return self.deviation <= 0.02


def measure_linearity(
    rig: Rig,
    whites: WhiteAndBlack,
    settle: float,
    period: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> CameraLinearity:
    """Photograph white and black at several exposures.

    `settle` and `period`, that of a flicker or 0, are in seconds. With a flicker, more frames are
    taken of each. `progress` is called with (done, total) exposures.
    """
    photographer = Photographer(rig, settle)
    black, white = plain_images(rig)
    # Seven exposures, each 1.6 times the one before, from the noise up to the brightest level.
    asked = whites.exposure * np.geomspace(1 / 16, 1, 7)
    asked = np.unique(asked.clip(*exposure_limits(rig.camera)))
    # Twelve frames at random moments of a flicker average it out.
    count = 12 if period else 3
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
