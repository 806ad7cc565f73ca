"""Whether two photographs show the same light, and how far two looks at one image are apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.frames.repeats import Steady

# Parts of the image, top to bottom, each of which has to agree.
_BANDS = 8
# Of the noise of a difference; of the light of a white frame in the same part.
_NOISE, _LIGHT = 1.3, 0.005
# Of the brightness, and in standard deviations of what flickers.
_GAIN, _GAIN_ERRORS = 0.01, 4.0
# Share of what was shown before one of them: harmless, and in standard errors.
_MIXED, _MIXED_ERRORS = 0.005, 4.0


@dataclass(frozen=True, eq=False)
class References:
    """The black and the white frame of a rig, as they were at the start.

    Parameters
    ----------
    black, white : Steady
        Of the longest and of the shortest exposure.
    dark : (rows, cols[, channels]) float32
        What the black frame would be at the white one's exposure.
    """

    black: Steady
    white: Steady
    dark: NDArray[np.float32]

    @property
    def light(self) -> NDArray[np.float32]:
        """White less black at the shortest exposure, raw levels."""
        return np.asarray(self.white.mean - self.dark)

    def agree(
        self,
        one: NDArray[Any],
        other: NDArray[Any],
        exposure: float,
        before: Sequence[NDArray[np.floating]] = (),
    ) -> bool:
        """Whether two frames of one exposure show the same light, everywhere.

        Parameters
        ----------
        one, other : (rows, cols[, channels])
            Raw levels.
        exposure : float
            Seconds.
        before : sequence of (rows, cols[, channels]) float
            The light that was shown before one or the other, in levels above black at this
            exposure. A small share of it is told from noise far sooner than any change is.
        """
        top = self.white.clip_level
        free = (one < top) & (other < top)
        dark = np.minimum(self.black.mean, self.dark)
        first, second = (np.where(free, frame - dark, 0.0) for frame in (one, other))
        power = float((second**2).sum())
        gain = float((first * second).sum()) / power if power else 1.0
        if abs(gain - 1) > max(_GAIN, _GAIN_ERRORS * self.white.gain):
            # Of a dark frame only the noise is left to agree.
            if float(np.sqrt(power / max(1, free.sum()))) > 3 * self.noise:
                return False
            gain = 1.0
        apart = np.where(free, first - gain * second, 0.0)
        for shown in before:
            towards = np.where(free, shown - second, 0.0)
            if gain != 1:
                # What a change of brightness does is no mixture.
                towards -= float((towards * second).sum()) / power * second
            size = float((towards**2).sum())
            error = np.sqrt(2) * self.noise / np.sqrt(max(size, 1e-9))
            mixed = abs(float((apart * towards).sum())) / max(size, 1e-9)
            if mixed > max(_MIXED, _MIXED_ERRORS * error):
                return False
        scale = exposure / self.white.exposure
        for rows in np.array_split(np.arange(len(one)), min(_BANDS, len(one))):
            count = max(1, int(free[rows].sum()))
            light = float(np.sqrt((self.light[rows] ** 2).mean())) * scale
            allowed = _NOISE * np.sqrt(2) * self.noise + _LIGHT * light + 0.3
            if float(np.sqrt((apart[rows] ** 2).sum() / count)) > allowed:
                return False
        return True

    @property
    def noise(self) -> float:
        """Standard deviation of a sample from frame to frame, in raw levels."""
        return max(self.black.noise, self.white.noise)


@dataclass(frozen=True)
class Drift:
    """How far a rig is from what it was at the start.

    Parameters
    ----------
    gain : float
        Its light now, as a share of that at the start.
    change : float
        What remains after that, relative to the light (L2): the scene, camera or projector moved.
    room : float
        Change of the room's light, as a share of the clip level.
    """

    gain: float
    change: float
    room: float

    def said(self) -> str | None:
        """What is worth saying of it; None if nothing is."""
        if self.change > 0.05:
            return f"the picture changed by {100 * self.change:.0f} %: did something move?"
        if abs(self.gain - 1) > 0.03:
            return f"the light is {100 * self.gain:.0f} % of what it was at the start"
        if abs(self.room) > 0.01:
            return f"the room's light changed by {100 * self.room:.1f} % of the clip level"
        return None


def drift(start: References, white: NDArray[np.floating], black: NDArray[np.floating]) -> Drift:
    """Compare a white and a black frame with those of the start.

    Parameters
    ----------
    start : References
    white, black : (rows, cols[, channels])
        Raw levels, at the same exposures.
    """
    top = start.white.clip_level
    free = (white < top) & (start.white.mean < top)
    before = np.where(free, start.light, 0.0)
    room = (np.asarray(black, np.float64) - start.black.mean) / (top or 1.0)
    share = start.white.exposure / start.black.exposure
    now = np.where(free, white - start.dark - share * room * top, 0.0)
    power = max(float((before**2).sum()), 1e-9)
    gain = float((now * before).sum()) / power
    noise = free.sum() * start.white.noise**2 * 1.5
    rest = max(0.0, float(((now - gain * before) ** 2).sum()) - noise)
    return Drift(gain, float(np.sqrt(rest / power)), float(room.mean()))
