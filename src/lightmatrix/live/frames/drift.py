"""Whether the rig has changed since the start of the capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.frames.same_light import References

# Drift is worth a warning if the picture changed by this share of its light, the lamp by this share
# of its light, or the room by this share of the clip level. Chosen by hand.
_CHANGE, _GAIN, _ROOM = 0.05, 0.03, 0.01
# The squared difference of two frames contains noise of this many variances of a white frame: 1 for
# the new frame, and the rest for the averaged references. Chosen by hand, rather too much.
_NOISE = 1.5


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
        if self.change > _CHANGE:
            return f"the picture changed by {100 * self.change:.0f} %: did something move?"
        if abs(self.gain - 1) > _GAIN:
            return f"the light is {100 * self.gain:.0f} % of what it was at the start"
        if abs(self.room) > _ROOM:
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
    noise = free.sum() * start.white.noise**2 * _NOISE
    rest = max(0.0, float(((now - gain * before) ** 2).sum()) - noise)
    return Drift(gain, float(np.sqrt(rest / power)), float(room.mean()))
