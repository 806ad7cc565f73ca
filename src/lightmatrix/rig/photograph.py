"""Photographs that can be right, judged by their times, and averages of them.

A `Photographer` shows an image, waits, and grabs a frame. It rejects frames that are stale or
handed out twice. Whether a frame shows its pattern is a question for `session`. The `References`
are the black and white frames at the start of a capture: they show whether two photographs have the
same light, and whether the rig has changed since.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.exposures import lit_samples, share_of_white
from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.rig.devices.base import Frame, exposure_limits, same_exposure, set_exposure
from lightmatrix.rig.rig import Rig, UnfitRigError

# Photographs that are tried for each one that is wanted.
TRIES = 4
# Seconds to wait after showing an image while the settle time is not known; a rig that takes longer
# needs to have it stated.
FIRST_SETTLE = 0.4


class UntrustedFrameError(DeviceError):
    """A frame cannot be right, or none arrived; the photograph has to be taken again."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame and its exposure in seconds, as the camera says."""

    frame: Frame
    exposure: float


@dataclass(eq=False)
class Photographer:
    """Takes single photographs with a rig."""

    rig: Rig
    # Seconds between an image being shown and the earliest start of an exposure.
    settle: float
    # The exposure that was last asked for, and what the camera made of it.
    _exposure: tuple[float, float] = (0.0, 0.0)
    _last: Frame | None = None

    def take(
        self, image: NDArray[np.uint8], exposure: float | None = None, settle: float | None = None
    ) -> Shot:
        """Show an image and photograph it (exposure and settle time in seconds; None: as set).

        An UntrustedFrameError says what is wrong with the frame; a DeviceError means that the
        camera was lost and is not back within a minute.
        """
        try:
            return self._take(image, exposure, self.settle if settle is None else settle)
        except (UntrustedFrameError, FrameTimeoutError) as error:
            raise UntrustedFrameError(error.message, hint=error.hint) from error
        except DeviceError as error:
            self.rig.recover()
            # The camera counts from the beginning, and may have forgotten its exposure.
            self._last, self._exposure = None, (0.0, 0.0)
            raise UntrustedFrameError(f"{error.message}, and came back") from error

    def _take(self, image: NDArray[np.uint8], exposure: float | None, settle: float) -> Shot:
        camera = self.rig.camera
        if exposure is None:
            actual = camera.exposure
        else:
            asked, actual = self._exposure
            if exposure != asked or not same_exposure(camera.exposure, actual):
                actual = set_exposure(camera, exposure)
                self._exposure = exposure, actual
        earliest = self.rig.projector.show(image) + settle
        self.rig.clock.sleep(earliest - self.rig.clock.now())
        camera.flush()
        camera.trigger()
        # No camera has buffers for 32 frames from before the pattern.
        for _ in range(32):
            frame = camera.get_image(camera.patience + 2 * actual)
            last, self._last = self._last, frame
            if last is not None and frame.timestamp <= last.timestamp:
                raise UntrustedFrameError("a frame was handed out twice")
            # Times are rounded to microseconds.
            if frame.timestamp - actual >= earliest - 1e-6:
                return Shot(frame, actual)
        hint = "are the camera's timestamps right?"
        raise UntrustedFrameError("32 frames came, all of before the pattern", hint=hint)


@dataclass(frozen=True, eq=False)
class AveragedFrame:
    """The mean of frames of one image."""

    # (rows, cols[, channels]): raw levels.
    mean: NDArray[np.float32]
    # The frames that agree.
    shots: list[Shot]
    # Standard deviation of a sample from frame to frame, in raw levels.
    noise: float
    # Standard deviation of the frames' brightness, as a share of it.
    gain: float

    @property
    def clip_level(self) -> float:
        """Raw level at which the camera clips."""
        return self.shots[0].frame.clip_level

    @property
    def exposure(self) -> float:
        """Seconds."""
        return self.shots[0].exposure

    @property
    def without_noise(self) -> NDArray[np.float32]:
        """The mean of black frames, or their median level if they show nothing but noise."""
        noise = self.noise / np.sqrt(len(self.shots))
        level = float(np.median([shot.frame.data for shot in self.shots]))
        apart = np.abs(self.mean - np.median(self.mean))
        # The median distance of normal noise from its mean is 0.67 standard deviations. A frame
        # with a spread up to 15 % above that shows nothing, but for hot pixels beyond 6 deviations.
        if np.median(apart) > 1.15 * 0.67 * noise:
            return self.mean
        return np.where(apart > 6 * noise, self.mean, np.float32(level))


def take_average(
    photographer: Photographer,
    image: NDArray[np.uint8],
    exposure: float | None = None,
    count: int = 4,
) -> AveragedFrame:
    """Photograph an image `count` times (at least 3), and average the frames that agree."""
    shots: list[Shot] = []
    reason, hint = "", None
    silent = 0
    settle = None
    for _ in range(TRIES * count):
        try:
            shots.append(photographer.take(image, exposure, settle))
        except UntrustedFrameError as error:
            reason, hint = error.message, error.hint
            silent += isinstance(error.__cause__, FrameTimeoutError)
            # A camera that gave no frame five times gives none at all.
            if silent == 5 and not shots:
                raise UnfitRigError(f"the camera gives no frames: {reason}", hint=hint) from error
        else:
            # After 0.1 s more even a late image is shown.
            settle = min(photographer.settle, 0.1)
        if len(shots) == count:
            break
    else:
        raise UnfitRigError(
            f"of {TRIES * count} frames of one image only {len(shots)} can be trusted; the last "
            f"of the others: {reason}",
            hint=hint or "look at the camera's picture with its own program, and at its cable",
        )
    stack = np.stack([shot.frame.data for shot in shots]).astype(np.float32)
    middle = np.median(stack, axis=0)
    distance = np.sqrt(((stack - middle) ** 2).mean(axis=tuple(range(1, stack.ndim))))
    near = distance <= 3 * max(float(np.median(distance)), 1e-3)
    agreeing = stack[near]
    mean = agreeing.mean(axis=0)
    spread = agreeing - mean
    noise = float(np.sqrt((spread**2).sum() / max(1, (len(agreeing) - 1) * mean.size)))
    bright = agreeing.reshape(len(agreeing), -1).mean(axis=1)
    gain = float(bright.std() / max(float(bright.mean()), 1e-6))
    kept = [shot for shot, good in zip(shots, near, strict=True) if good]
    return AveragedFrame(mean.astype(np.float32), kept, noise, gain)


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
    """Photograph white and black at an exposure chosen for white, or raise an UnfitRigError.

    The bright samples of white shall be between 0.35 and 0.9 of the clip level, best at 0.7: that
    is bright, and away from clipping if the light flickers. Bright is the 0.99 quantile, so that
    single glints do not count.
    """
    shortest, longest = exposure_limits(photographer.rig.camera)
    exposure = float(np.clip(photographer.rig.camera.exposure, shortest, longest))
    # The whole range of a camera, 1 to 10^6, takes 7 steps of a factor of 8.
    for _ in range(12):
        pair = take_white_and_black(photographer, exposure)
        top = pair.white.clip_level
        pedestal = float(np.median(pair.black.mean))
        share = (float(np.quantile(pair.white.mean, 0.99)) - pedestal) / max(top - pedestal, 1.0)
        if pedestal > 0.9 * top:
            # The room alone makes the camera clip.
            share = 1.0
        # If white hardly differs from black, it is lit by the room or not at all.
        visible = float(np.quantile(pair.light, 0.99)) / top > 0.02
        at_shortest, at_longest = exposure <= 1.01 * shortest, exposure >= 0.99 * longest
        if 0.35 <= share <= 0.9 or (at_longest and visible) or (at_shortest and share <= 0.9):
            if visible:
                return pair
            break
        factor = 1 / 8 if share > 0.9 else min(8.0, 0.7 / max(share, 1e-3))
        if (factor < 1 and at_shortest) or (factor > 1 and at_longest):
            break
        exposure = float(np.clip(exposure * factor, shortest, longest))
    if share > 0.9 and exposure <= 1.01 * shortest:
        raise UnfitRigError(
            f"the white picture clips even at the camera's shortest exposure, {exposure:g} s",
            hint="close the camera's aperture, lower its gain, or dim the projector",
        )
    raise UnfitRigError(
        "the camera does not see the projector: a white picture looks like a black one",
        hint="is the projector on, its lens uncovered, the picture on the right monitor, and the "
        f"camera pointed at it? One that comes {photographer.settle:g} s late is not seen either: "
        "state how long to wait, settle=1",
    )


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

    def dark_at(self, exposure: float) -> NDArray[np.float32]:
        """The black frame at an exposure in seconds."""
        long, short = self.black.exposure, self.white.exposure
        share = (exposure - short) / (long - short) if long != short else 1.0
        return np.asarray(self.dark + share * (self.black.mean - self.dark), np.float32)

    def change(self, white: NDArray[np.floating], black: NDArray[np.floating]) -> str | None:
        """What differs most in a white and a black frame of before; None if little does.

        Both are raw levels at the same exposures.
        """
        top = self.white.clip_level
        free = (white < top) & (self.white.mean < top)
        now = np.where(free, self.light, 0.0)
        room = (self.black.mean - black) / top
        share = self.white.exposure / self.black.exposure
        before = np.where(free, white - self.dark + share * room * top, 0.0)
        power = max(float((before**2).sum()), 1e-9)
        gain = float((now * before).sum()) / power
        # The squared difference contains the noise of both averages.
        noise = free.sum() * self.white.noise**2 * 0.5
        rest = np.sqrt(max(0.0, float(((now - gain * before) ** 2).sum()) - noise) / power)
        if rest > 0.05:
            return f"the picture changed by {100 * rest:.0f} %: did something move?"
        if abs(gain - 1) > 0.03:
            return f"the light is {100 * gain:.0f} % of what it was"
        if abs(room.mean()) > 0.01:
            return f"the room's light changed by {100 * room.mean():.1f} % of the clip level"
        return None

    def agree(
        self,
        one: NDArray[Any],
        other: NDArray[Any],
        exposure: float,
        before: Sequence[NDArray[np.floating]] = (),
    ) -> bool:
        """Whether two frames of raw levels, of one exposure, show the same light everywhere.

        `before` is the light shown before one or the other, in levels above black: a small share of
        known light stands out from noise far sooner than an unknown change does. The tolerances
        are chosen so that `python -m benchmarks.rig_mixtures` keeps less light of late images than
        noise.
        """
        free = (one < self.white.clip_level) & (other < self.white.clip_level)
        dark = np.minimum(self.black.mean, self.dark)
        first, second = (np.where(free, frame - dark, 0.0) for frame in (one, other))
        power = float((second**2).sum())
        gain = float((first * second).sum()) / power if power else 1.0
        # The brightness may differ by 1 %, or by 4 standard errors.
        if abs(gain - 1) > max(0.01, 4 * self.white.gain):
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
            # Half a per cent of the image before is harmless, and so are 4 standard errors.
            if share > max(0.005, 4 * error):
                return False
        # In each of eight bands, frames may differ by 1.3 standard deviations of a difference, 0.3
        # raw levels of rounding, and 0.5 % of the light of a white frame at their exposure.
        noise = 1.3 * np.sqrt(2) * self.noise + 0.3
        scale = 0.005 * exposure / self.white.exposure
        for rows in np.array_split(np.arange(len(apart)), min(8, len(apart))):
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
    waiting = replace(photographer, settle=max(FIRST_SETTLE, photographer.settle))
    # The noise of the black frame enters all samples alike, so more frames are averaged for it.
    dark = dark_short = take_average(waiting, black, long, 8)
    if short != long:
        dark_short = take_average(photographer, black, short, 3)
    bright = take_average(waiting, white, short, 5)
    references = References(dark, bright, dark_short.mean)
    if np.quantile(references.light, 0.99) < 0.01 * bright.clip_level:
        raise UnfitRigError(
            f"at {short:g} s, a white picture looks like a black one",
            hint="leave the exposure to be measured, or choose one at which white neither clips "
            "nor is dark",
        )
    return references
