"""Flicker: of the projector's lamp, or of the room's light, at a frequency that may be known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.devices.exposures import same_exposure, set_exposure
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.measurements.white import Whites, find_white, images
from lightmatrix.live.rig import Rig

# Frames of each of white and black: to measure it, and to see whether it is as it was.
_FRAMES, _FEW = 48, 7
# Twice the mains, which lamps follow.
_MAINS = (100.0, 120.0)
# Exposures far below a period, where the light allows it.
_SHORT = 0.002
# Of the brightness: below this nothing is called flicker, nor within so many standard errors.
_NOTICED, _ERRORS = 0.004, 4.0
# Of the brightness: a light that varies by twice what it did, and this, has changed.
_MORE = 0.01
_Series = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Flicker:
    """Light that comes and goes under a picture that stays.

    Parameters
    ----------
    amplitude : float
        Of the projector's light, as a share of it; 0 where none was noticed.
    frequency : float
        Hz, of those that were tried; 0 where none was noticed.
    spread : float
        Standard deviation of the brightness of short frames, as a share of it.
    room : float
        Standard deviation of the black frames' mean, as a share of white.
    """

    amplitude: float
    frequency: float
    spread: float
    room: float

    @property
    def noticed(self) -> bool:
        """Whether the projector's light flickers."""
        return self.amplitude > 0

    @property
    def period(self) -> float:
        """Seconds that exposures should be a multiple of; 0 where nothing flickers."""
        return 1 / self.frequency if self.frequency else 0.0


def measure_flicker(
    rig: Rig,
    *,
    settle: float,
    whites: Whites | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Flicker:
    """Photograph a white and a black picture many times, at a short exposure.

    Tried are twice the mains (100 and 120 Hz), the projector's refresh and twice that. Those that
    the camera's own rhythm hides from it do no harm in its frames.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    whites : Whites, optional
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
    taker = Taker(rig, settle)
    whites = whites or find_white(taker)
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, _FRAMES, progress)
    (times, bright), (_, dark) = series
    level = float(np.median(bright) - np.median(dark))
    refresh = float(rig.projector.info().get("refresh") or 60.0)
    tried = dict.fromkeys((*_MAINS, refresh, 2 * refresh))
    amplitude, frequency = 0.0, 0.0
    for candidate in tried:
        seen, error = _wave(times - exposure / 2, bright / level, candidate)
        # The exposure itself averages the wave.
        seen /= max(abs(float(np.sinc(candidate * exposure))), 0.05)
        if seen > max(_NOTICED, _ERRORS * error, 1.1 * amplitude):
            amplitude, frequency = seen, candidate
    return Flicker(amplitude, frequency, float(bright.std()) / level, float(dark.std()) / level)


def flickers_anew(rig: Rig, known: Flicker, *, settle: float, whites: Whites) -> bool:
    """Whether the lamp's light or the room's varies clearly more than it did, by a few frames.

    Parameters
    ----------
    rig : Rig
    known : Flicker
        What was measured at length before.
    settle : float
        Seconds.
    whites : Whites
        White and black frame of now.

    Raises
    ------
    DeviceError
        If the camera is lost, or gives no frames.
    """
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, _FEW)
    bright, dark = (levels for _, levels in series)
    level = float(np.median(bright) - np.median(dark))
    # By medians: one of the frames may be a copy of an earlier one, or torn.
    lamp, room = (
        1.48 * float(np.median(np.abs(levels - np.median(levels)))) / level
        for levels in (bright, dark)
    )
    return lamp > 2 * known.spread + _MORE or room > 2 * known.room + _MORE


def _white_and_black(
    rig: Rig,
    whites: Whites,
    exposure: float,
    settle: float,
    count: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[_Series]:
    """Series of frames of a white and of a black picture, at an exposure that is set."""
    camera = rig.camera
    series = []
    for number, image in enumerate(reversed(images(rig))):
        shown = rig.projector.show(image)
        # As long as the latest pattern may take.
        rig.clock.sleep(shown + settle + 0.3 - rig.clock.now())
        camera.flush()

        def tell(done: int, first: int = number * count) -> None:
            if progress is not None:
                progress(first + done, 2 * count)

        found = _series(rig, whites, count, tell)
        if not same_exposure(camera.exposure, exposure):
            # Another program has changed it.
            set_exposure(camera, exposure)
            found = _series(rig, whites, count, tell)
        series.append(found)
    return series


def _series(rig: Rig, whites: Whites, count: int, tell: Callable[[int], None]) -> _Series:
    """Times of frames and their mean levels over the lit samples."""
    lit = whites.lit
    generator = np.random.default_rng(0)
    times, levels = [], []
    seen = -np.inf
    for tried in range(2 * count):
        # A camera that is triggered could else keep step with the light.
        rig.clock.sleep(float(generator.random()) * 0.012)
        rig.camera.trigger()
        try:
            frame = rig.camera.get_image(rig.patience)
        except FrameTimeoutError:
            continue
        if frame.timestamp > seen:
            seen = frame.timestamp
            times.append(frame.timestamp)
            levels.append(float(np.asarray(frame.data, np.float64)[lit].mean()))
            tell(min(tried + 1, count))
        if len(times) == count:
            break
    return np.array(times), np.array(levels)


def _wave(
    times: NDArray[np.float64], light: NDArray[np.float64], frequency: float
) -> tuple[float, float]:
    """Amplitude of a frequency in a series, and its standard error."""
    turn = 2 * np.pi * frequency * (times - times[0])
    basis = np.column_stack([np.cos(turn), np.sin(turn), np.ones_like(turn)])
    # Where the camera keeps step with the light, there is no wave to see.
    spread = basis[:, :2] - basis[:, :2].mean(axis=0)
    if np.linalg.svd(spread, compute_uv=False)[-1] < 0.15 * np.sqrt(len(times)):
        return 0.0, 0.0
    waves, *_ = np.linalg.lstsq(basis, light, rcond=None)
    rest = light - basis @ waves
    error = float(np.sqrt((rest**2).sum() / max(1, len(times) - 3) * 2 / len(times)))
    return float(np.hypot(*waves[:2])), error
