"""The black and white frames of a rig at the start of a capture, and what is judged by them.

They show whether two photographs have the same light, and whether the rig has changed since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.rig.photograph import (
    FIRST_SETTLE,
    AveragedFrame,
    Photographer,
    plain_images,
    take_average,
)
from lightmatrix.rig.rig import UnfitRigError


@dataclass(frozen=True)
class _Tolerances:
    """How far two photographs of the same light may be apart.

    Chosen so that `python -m tests.live.rig_mixtures` keeps less light of late images than noise.
    """

    # Parts of the image from top to bottom, each of which has to agree.
    bands: int = 8
    # Difference that noise explains, in standard deviations of a difference.
    noise: float = 1.3
    # Further difference, as a share of the light of a white frame in the same band.
    light: float = 0.005
    # Further difference in raw levels.
    rounding: float = 0.3
    # Difference of brightness, as a share of it; share of the image that was shown before.
    gain: float = 0.01
    mixed: float = 0.005
    # More of either is harmless up to so many standard errors.
    errors: float = 4.0


_TOLERANCES = _Tolerances()


@dataclass(frozen=True, eq=False)
class References:
    """The black and the white frame of a rig at the start of a capture."""

    # Black at the longest exposure, white at the shortest.
    black: AveragedFrame
    white: AveragedFrame
    # (rows, cols[, channels]): the black frame at the white one's exposure.
    dark: NDArray[np.float32]

    @property
    def light(self) -> NDArray[np.float32]:
        """White less black at the shortest exposure, raw levels."""
        return np.asarray(self.white.mean - self.dark)

    @property
    def noise(self) -> float:
        """Standard deviation of a sample from frame to frame, in raw levels."""
        return max(self.black.noise, self.white.noise)

    def agree(
        self,
        one: NDArray[Any],
        other: NDArray[Any],
        exposure: float,
        before: Sequence[NDArray[np.floating]] = (),
    ) -> bool:
        """Whether two frames of raw levels, of one exposure, show the same light everywhere.

        `before` is the light shown before one or the other, in levels above black: a small share of
        known light stands out from noise far sooner than an unknown change does.
        """
        free = (one < self.white.clip_level) & (other < self.white.clip_level)
        dark = np.minimum(self.black.mean, self.dark)
        first, second = (np.where(free, frame - dark, 0.0) for frame in (one, other))
        power = float((second**2).sum())
        gain = float((first * second).sum()) / power if power else 1.0
        if abs(gain - 1) > max(_TOLERANCES.gain, _TOLERANCES.errors * self.white.gain):
            # The brightness of a dark frame is known no better than its noise.
            if float(np.sqrt(power / max(1, free.sum()))) > 3 * self.noise:
                return False
            gain = 1.0
        apart = np.where(free, first - gain * second, 0.0)
        for shown in before:
            towards = np.where(free, shown - second, 0.0)
            if gain != 1:
                # A change of brightness is no mixture.
                towards -= float((towards * second).sum()) / power * second
            size = max(float((towards**2).sum()), 1e-9)
            error = np.sqrt(2) * self.noise / np.sqrt(size)
            share = abs(float((apart * towards).sum())) / size
            if share > max(_TOLERANCES.mixed, _TOLERANCES.errors * error):
                return False
        noise = _TOLERANCES.noise * np.sqrt(2) * self.noise + _TOLERANCES.rounding
        # White is so many times as bright at the exposure of the frames.
        scale = _TOLERANCES.light * exposure / self.white.exposure
        for rows in np.array_split(np.arange(len(apart)), min(_TOLERANCES.bands, len(apart))):
            light = float(np.sqrt((self.light[rows] ** 2).mean()))
            missed = float(np.sqrt((apart[rows] ** 2).sum() / max(1, int(free[rows].sum()))))
            if missed > noise + scale * light:
                return False
        return True


def take_references(photographer: Photographer, seconds: NDArray[np.float64]) -> References:
    """Photograph black at the longest and white at the shortest of the exposures `seconds`."""
    black, white = plain_images(photographer.rig)
    long, short = float(seconds.max()), float(seconds.min())
    # The first frames wait longer, so that nothing of an earlier image is left.
    waiting = replace(photographer, settle=FIRST_SETTLE)
    # The noise of the black frame enters all samples alike, so more frames are averaged for it.
    dark = dark_short = take_average(waiting, black, long, 8)
    if short != long:
        dark_short = take_average(photographer, black, short, 3)
    waiting = replace(photographer, settle=FIRST_SETTLE)
    bright = take_average(waiting, white, short, 5)
    references = References(dark, bright, dark_short.mean)
    if np.quantile(references.light, 0.99) < 0.01 * bright.clip_level:
        raise UnfitRigError(
            f"at {short:g} s, a white picture looks like a black one",
            hint="leave the exposure to be measured, or choose one at which white neither clips "
            "nor is dark",
        )
    return references


@dataclass(frozen=True)
class Drift:
    """How far a rig is from its state at the start."""

    # Its light now, as a share of that at the start.
    gain: float
    # What remains after that, relative to the light (L2): the scene, camera or projector moved.
    change: float
    # Change of the room's light, as a share of the clip level.
    room: float

    def warning(self) -> str | None:
        """The largest concern in words; None if the drift is small."""
        if self.change > 0.05:
            return f"the picture changed by {100 * self.change:.0f} %: did something move?"
        if abs(self.gain - 1) > 0.03:
            return f"the light is {100 * self.gain:.0f} % of what it was at the start"
        if abs(self.room) > 0.01:
            return f"the room's light changed by {100 * self.room:.1f} % of the clip level"
        return None


def measure_drift(
    start: References, white: NDArray[np.floating], black: NDArray[np.floating]
) -> Drift:
    """Compare a white and a black frame (raw levels, same exposures) with those of the start."""
    top = start.white.clip_level
    free = (white < top) & (start.white.mean < top)
    before = np.where(free, start.light, 0.0)
    room = (np.asarray(black, np.float64) - start.black.mean) / (top or 1.0)
    share = start.white.exposure / start.black.exposure
    now = np.where(free, white - start.dark - share * room * top, 0.0)
    power = max(float((before**2).sum()), 1e-9)
    gain = float((now * before).sum()) / power
    # The squared difference contains the noise of the new frame, and half as much of the averaged
    # references.
    noise = free.sum() * start.white.noise**2 * 1.5
    rest = max(0.0, float(((now - gain * before) ** 2).sum()) - noise)
    return Drift(gain, float(np.sqrt(rest / power)), float(room.mean()))
