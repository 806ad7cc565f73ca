"""Flicker of the projector's lamp or of the room's light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.devices.base import same_exposure, set_exposure
from lightmatrix.live.photograph import (
    Photographer,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
)
from lightmatrix.live.rig import Rig

# Frames of white and of black: to measure flicker, and to see whether it is as it was.
_FRAMES, _FEW_FRAMES = 48, 7
# Frequencies in Hz at which lamps on mains of 50 and 60 Hz flicker.
_MAINS = (100.0, 120.0)
# Exposure in seconds, far below a period of the mains, if there is enough light for it.
_SHORT = 0.002
# An amplitude counts as flicker above this share of the brightness, and above so many standard
# errors. Chosen by hand: five virtual rigs without flicker show none (tests/live).
_NOTICED, _ERRORS = 0.004, 4.0
# A stronger wave replaces the strongest one so far only if it exceeds it by this factor, so that
# frequencies that are tried earlier win if both fit.
_STRONGER = 1.1
# The light has changed if it varies by more than twice as much as it did, plus this share of the
# brightness.
_MORE = 0.01
# Frames are taken at random moments of this many seconds, about a period of the mains. Otherwise a
# triggered camera could keep step with the light.
_RANDOM_WAIT = 0.012
# Seconds to wait beyond the settle time, so that even a late image is shown.
_LATE_IMAGE = 0.3
# Frequencies that the camera's own rhythm hides are recognized by a basis of waves whose smallest
# singular value is below this share of the square root of the number of frames. Chosen by hand.
_HIDDEN = 0.15
# Seconds of the frames and their mean levels.
_Series = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Flicker:
    """Light that varies although the picture stays."""

    # Amplitude of the projector's light, as a share of it; 0 if none was noticed.
    amplitude: float
    # Hz, one of those that were tried; 0 if none was noticed.
    frequency: float
    # Standard deviation of the brightness of short frames, as a share of it.
    spread: float
    # Standard deviation of the black frames' mean, as a share of white.
    room: float

    @property
    def noticed(self) -> bool:
        """Whether the projector's light flickers."""
        return self.amplitude > 0

    @property
    def period(self) -> float:
        """Seconds that exposures should be a multiple of; 0 if nothing flickers."""
        return 1 / self.frequency if self.frequency else 0.0


def measure_flicker(
    rig: Rig,
    *,
    settle: float,
    whites: WhiteAndBlack | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Flicker:
    """Photograph a white and a black picture many times, at a short exposure.

    The frequencies that are tried are those of lamps on the mains (100 and 120 Hz), the projector's
    refresh, and twice that. One that the camera's own rhythm hides does no harm in its frames.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    whites : WhiteAndBlack, optional
        White and black frame, if they are known already.
    progress : callable, optional
        Called with (done, total) frames.

    Returns
    -------
    Flicker

    Raises
    ------
    DeviceError
        If the camera does not see the projector.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,flicker=0.1,real=0") as rig:
    ...     flicker = lm.measure_flicker(rig, settle=0.05)
    >>> round(flicker.amplitude, 1), flicker.frequency
    (0.1, 100.0)
    """
    whites = whites or find_white_and_black(Photographer(rig, settle))
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, _FRAMES, progress)
    (times, bright), (_, dark) = series
    level = float(np.median(bright) - np.median(dark))
    refresh = float(rig.projector.info().get("refresh") or 60.0)
    tried = dict.fromkeys((*_MAINS, refresh, 2 * refresh))
    amplitude, frequency = 0.0, 0.0
    for candidate in tried:
        wave, error = _wave(times - exposure / 2, bright / level, candidate)
        # The exposure averages the wave.
        wave /= max(abs(float(np.sinc(candidate * exposure))), 0.05)
        if wave > max(_NOTICED, _ERRORS * error, _STRONGER * amplitude):
            amplitude, frequency = wave, candidate
    return Flicker(amplitude, frequency, float(bright.std()) / level, float(dark.std()) / level)


def flicker_has_grown(rig: Rig, known: Flicker, *, settle: float, whites: WhiteAndBlack) -> bool:
    """Whether a few frames show that the lamp or room varies clearly more than `known` before."""
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, _FEW_FRAMES)
    bright, dark = (levels for _, levels in series)
    level = float(np.median(bright) - np.median(dark))
    # Medians, since one of the frames may be torn or a copy of an earlier one.
    lamp, room = (
        1.48 * float(np.median(np.abs(levels - np.median(levels)))) / level
        for levels in (bright, dark)
    )
    return lamp > 2 * known.spread + _MORE or room > 2 * known.room + _MORE


def _white_and_black(
    rig: Rig,
    whites: WhiteAndBlack,
    exposure: float,
    settle: float,
    count: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[_Series]:
    """Series of frames of a white and of a black picture, at the exposure that is set."""
    camera = rig.camera
    series = []
    for number, image in enumerate(reversed(plain_images(rig))):
        shown = rig.projector.show(image)
        rig.clock.sleep(shown + settle + _LATE_IMAGE - rig.clock.now())
        camera.flush()

        def report(done: int, first: int = number * count) -> None:
            if progress is not None:
                progress(first + done, 2 * count)

        frames = _series(rig, whites, count, report)
        if not same_exposure(camera.exposure, exposure):
            # Another program has changed the exposure.
            set_exposure(camera, exposure)
            frames = _series(rig, whites, count, report)
        series.append(frames)
    return series


def _series(rig: Rig, whites: WhiteAndBlack, count: int, report: Callable[[int], None]) -> _Series:
    """Times of frames and their mean levels over the lit samples."""
    lit = whites.lit
    generator = np.random.default_rng(0)
    times, levels = [], []
    latest = -np.inf
    for tried in range(2 * count):
        rig.clock.sleep(float(generator.random()) * _RANDOM_WAIT)
        rig.camera.trigger()
        try:
            frame = rig.camera.get_image(rig.patience)
        except FrameTimeoutError:
            continue
        if frame.timestamp > latest:
            latest = frame.timestamp
            times.append(frame.timestamp)
            levels.append(float(np.asarray(frame.data, np.float64)[lit].mean()))
            report(min(tried + 1, count))
        if len(times) == count:
            break
    return np.array(times), np.array(levels)


def _wave(
    times: NDArray[np.float64], light: NDArray[np.float64], frequency: float
) -> tuple[float, float]:
    """Amplitude of a frequency in a series, and its standard error."""
    phase = 2 * np.pi * frequency * (times - times[0])
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
    spread = basis[:, :2] - basis[:, :2].mean(axis=0)
    if np.linalg.svd(spread, compute_uv=False)[-1] < _HIDDEN * np.sqrt(len(times)):
        return 0.0, 0.0
    waves, *_ = np.linalg.lstsq(basis, light, rcond=None)
    rest = light - basis @ waves
    error = float(np.sqrt((rest**2).sum() / max(1, len(times) - 3) * 2 / len(times)))
    return float(np.hypot(*waves[:2])), error
