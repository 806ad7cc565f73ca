"""Several frames of one image, of which those that agree are averaged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.frames.photograph import Shot, Taker, UntrustedFrameError
from lightmatrix.live.rig import UnfitRigError

# Frames that are tried for each that is wanted.
_TRIES = 4
# Frames that do not come, before any has, after which none is waited for any more.
_SILENT = 5
# Of the usual distance from the median frame.
_APART = 3.0
# Seconds to wait for an image that is shown already; one that is late has come by then.
_AGAIN = 0.1
# Of the noise: a spread over the image that is no more, and single pixels that stand out.
_ONLY_NOISE, _HOT = 1.15, 6.0


@dataclass(frozen=True, eq=False)
class Steady:
    """The mean of frames of one image.

    Parameters
    ----------
    mean : (rows, cols[, channels]) float32
        Raw levels.
    shots : list of Shot
        The frames that agree.
    noise : float
        Standard deviation of a sample from frame to frame, in raw levels.
    gain : float
        Standard deviation of the frames' brightness, as a share of it.
    """

    mean: NDArray[np.float32]
    shots: list[Shot]
    noise: float
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
        """The mean, but one level all over where nothing but noise is seen; for black frames.

        That level is a median: noise that is cut off at zero does not raise it.
        """
        noise = self.noise / np.sqrt(len(self.shots))
        level = float(np.median([shot.data for shot in self.shots]))
        apart = np.abs(self.mean - np.median(self.mean))
        # Of a normal distribution, the median distance is 0.67 standard deviations.
        if np.median(apart) > _ONLY_NOISE * 0.67 * noise:
            return self.mean
        return np.where(apart > _HOT * noise, self.mean, np.float32(level))

    @property
    def changing(self) -> NDArray[np.float64]:
        """Share of the samples of each row that change from frame to frame, (rows,)."""
        data = [shot.data.reshape(len(shot.data), -1) for shot in self.shots]
        # The median, since one of the frames may be a copy.
        return np.asarray(np.median([(a != b).mean(axis=1) for a, b in pairwise(data)], axis=0))


def take_steady(
    taker: Taker, image: NDArray[np.uint8], exposure: float | None = None, count: int = 4
) -> Steady:
    """Photograph an image several times, and leave out what does not agree with the rest.

    Parameters
    ----------
    taker : Taker
    image : (rows, cols) uint8
    exposure : float, optional
        Seconds; None: as the camera is set.
    count : int
        Frames to take, at least 3.

    Raises
    ------
    DeviceError
        If hardly any frame can be trusted.
    """
    shots: list[Shot] = []
    reason, hint = "", None
    silent = 0
    settle = None
    for _ in range(_TRIES * count):
        try:
            shots.append(taker.take(image, exposure, settle))
        except UntrustedFrameError as error:
            reason, hint = error.message, error.hint
            silent += isinstance(error.__cause__, FrameTimeoutError)
            if silent == _SILENT and not shots:
                raise UnfitRigError(f"the camera gives no frames: {reason}", hint=hint) from error
        else:
            # It has been there long since.
            settle = min(taker.settle, _AGAIN)
        if len(shots) == count:
            break
    else:
        raise UnfitRigError(
            f"of {_TRIES * count} frames of one image only {len(shots)} can be trusted; the last "
            f"of the others: {reason}",
            hint=hint or "look at the camera's picture with its own program, and at its cable",
        )
    stack = np.stack([shot.data for shot in shots]).astype(np.float32)
    middle = np.median(stack, axis=0)
    distance = np.sqrt(((stack - middle) ** 2).mean(axis=tuple(range(1, stack.ndim))))
    near = distance <= _APART * max(float(np.median(distance)), 1e-3)
    kept = stack[near]
    mean = kept.mean(axis=0)
    spread = kept - mean
    noise = float(np.sqrt((spread**2).sum() / max(1, (len(kept) - 1) * mean.size)))
    bright = kept.reshape(len(kept), -1).mean(axis=1)
    gain = float(bright.std() / max(float(bright.mean()), 1e-6))
    agreeing = [shot for shot, good in zip(shots, near, strict=True) if good]
    return Steady(mean.astype(np.float32), agreeing, noise, gain)
