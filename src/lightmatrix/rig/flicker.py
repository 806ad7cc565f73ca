"""Flicker of the projector's lamp or of the room's light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.rig.devices.base import same_exposure, set_exposure
from lightmatrix.rig.photograph import (
    WhiteAndBlack,
    plain_images,
    robust_deviation,
)
from lightmatrix.rig.rig import Rig

# Exposure in seconds, far below a period of the mains, if there is enough light for it.
_SHORT = 0.002
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
    whites: WhiteAndBlack,
    settle: float,
    progress: Callable[[int, int], None] | None = None,
) -> Flicker:
    """Photograph a white and a black picture many times, at a short exposure.

    The frequencies that are tried are those of lamps on the mains (100 and 120 Hz), the projector's
    refresh, and twice that. One that the camera's own rhythm hides does no harm in its frames.
    `settle` is in seconds; `progress` is called with (done, total) frames.
    """
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, 48, progress)
    (times, bright), (_, dark) = series
    level = float(np.median(bright) - np.median(dark))
    refresh = float(rig.projector.info().get("refresh") or 60.0)
    # Lamps on mains of 50 and 60 Hz flicker at 100 and 120 Hz.
    tried = dict.fromkeys((100.0, 120.0, refresh, 2 * refresh))
    amplitude, frequency = 0.0, 0.0
    for candidate in tried:
        wave, error = _wave(times - exposure / 2, bright / level, candidate)
        # The exposure averages the wave.
        wave /= max(abs(float(np.sinc(candidate * exposure))), 0.05)
        # Five virtual rigs without flicker show none above 0.4 % and four standard errors. If two
        # frequencies fit, the one tried first wins.
        if wave > max(0.004, 4 * error, 1.1 * amplitude):
            amplitude, frequency = wave, candidate
    return Flicker(amplitude, frequency, float(bright.std()) / level, float(dark.std()) / level)


def flicker_has_grown(rig: Rig, whites: WhiteAndBlack, settle: float, known: Flicker) -> bool:
    """Whether a few frames show that the lamp or room varies clearly more than `known` before."""
    exposure = set_exposure(rig.camera, min(_SHORT, whites.exposure))
    series = _white_and_black(rig, whites, exposure, settle, 7)
    bright, dark = (levels for _, levels in series)
    level = float(np.median(bright) - np.median(dark))
    lamp, room = robust_deviation(bright) / level, robust_deviation(dark) / level
    return lamp > 2 * known.spread + 0.01 or room > 2 * known.room + 0.01


def _white_and_black(
    rig: Rig,
    whites: WhiteAndBlack,
    exposure: float,
    settle: float,
    count: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[_Series]:
    """Series of frames of a white and of a black picture, at the exposure that is set."""
    camera, total = rig.camera, 2 * count
    lit = whites.lit
    series = []
    for number, image in enumerate(reversed(plain_images(rig))):
        shown = rig.projector.show(image)
        # After 0.3 s more even a late image is shown.
        rig.clock.sleep(shown + settle + 0.3 - rig.clock.now())
        camera.flush()
        # A second try is for another program that changes the exposure.
        for _ in range(2):
            generator = np.random.default_rng(0)
            times: list[float] = []
            levels: list[float] = []
            for _ in range(total):
                # At regular moments a triggered camera could keep step with the light, whose period
                # is about 12 ms.
                rig.clock.sleep(float(generator.random()) * 0.012)
                camera.trigger()
                try:
                    frame = camera.get_image(rig.patience)
                except FrameTimeoutError:
                    continue
                if not times or frame.timestamp > times[-1]:
                    times.append(frame.timestamp)
                    levels.append(float(np.asarray(frame.data, np.float64)[lit].mean()))
                    if progress is not None:
                        progress(number * count + len(times), total)
                if len(times) == count:
                    break
            if same_exposure(camera.exposure, exposure):
                break
            set_exposure(camera, exposure)
        series.append((np.array(times), np.array(levels)))
    return series


def _wave(
    times: NDArray[np.float64], light: NDArray[np.float64], frequency: float
) -> tuple[float, float]:
    """Amplitude of a frequency in a series, and its standard error."""
    phase = 2 * np.pi * frequency * (times - times[0])
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
    spread = basis[:, :2] - basis[:, :2].mean(axis=0)
    # The camera's own rhythm may hide a frequency.
    if np.linalg.svd(spread, compute_uv=False)[-1] < 0.15 * np.sqrt(len(times)):
        return 0.0, 0.0
    waves, *_ = np.linalg.lstsq(basis, light, rcond=None)
    rest = light - basis @ waves
    error = float(np.sqrt((rest**2).sum() / max(1, len(times) - 3) * 2 / len(times)))
    return float(np.hypot(*waves[:2])), error
