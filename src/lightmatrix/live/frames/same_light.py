"""Whether two photographs show the same light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.frames.repeats import AveragedFrame


@dataclass(frozen=True)
class _Tolerances:
    """How far two photographs of the same light may be apart. Chosen by hand.

    `python -m tests.live.rig_mixtures` measures what passes on rigs whose images come late.
    """

    # Parts of the image from top to bottom, each of which has to agree.
    bands: int = 8
    # Difference that noise explains, in standard deviations of a difference.
    noise: float = 1.3
    # Further difference, as a share of the light of a white frame in the same band.
    light: float = 0.005
    # Further difference in raw levels.
    rounding: float = 0.3
    # Difference of brightness: as a share of it, or in standard deviations of what flickers.
    gain: float = 0.01
    gain_errors: float = 4.0
    # Share of the image that was shown before: harmless up to the first, or up to so many of its
    # standard errors.
    mixed: float = 0.005
    mixed_errors: float = 4.0


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
        if abs(gain - 1) > max(_TOLERANCES.gain, _TOLERANCES.gain_errors * self.white.gain):
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
            if self._mixed(apart, towards):
                return False
        return self._alike(apart, free, exposure / self.white.exposure)

    def _mixed(self, apart: NDArray[np.floating], towards: NDArray[np.floating]) -> bool:
        """Whether a difference contains more of a known one than noise explains."""
        size = float((towards**2).sum())
        error = np.sqrt(2) * self.noise / np.sqrt(max(size, 1e-9))
        share = abs(float((apart * towards).sum())) / max(size, 1e-9)
        return bool(share > max(_TOLERANCES.mixed, _TOLERANCES.mixed_errors * error))

    def _alike(self, apart: NDArray[np.floating], free: NDArray[np.bool_], scale: float) -> bool:
        """Whether a difference is small in each band; white is `scale` times as bright."""
        bands = min(_TOLERANCES.bands, len(apart))
        for rows in np.array_split(np.arange(len(apart)), bands):
            count = max(1, int(free[rows].sum()))
            light = float(np.sqrt((self.light[rows] ** 2).mean())) * scale
            noise = _TOLERANCES.noise * np.sqrt(2) * self.noise
            allowed = noise + _TOLERANCES.light * light + _TOLERANCES.rounding
            if float(np.sqrt((apart[rows] ** 2).sum() / count)) > allowed:
                return False
        return True
