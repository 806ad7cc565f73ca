"""Whether several photographs of one image agree, and the mean of those that do."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.frames.photograph import Photographer, Shot, UntrustedFrameError
from lightmatrix.live.rig import UnfitRigError

# Photographs that are tried for each frame that is wanted. Chosen by hand.
_TRIES = 4
# A camera that has not given any frame after this many timeouts gives none at all.
_SILENT = 5
# A frame is left out if its distance from the median frame is this many times the usual one.
_OUTLIER = 3.0
# Seconds to wait before the second and further frames: even a late image is shown by then.
_AGAIN = 0.1
# A black frame shows nothing but noise if its spread over the image is at most this many times that
# of noise. Single samples beyond so many standard deviations are hot pixels.
_ONLY_NOISE, _HOT = 1.15, 6.0
# The median distance of a normal distribution from its mean, in standard deviations.
_MEDIAN_DISTANCE = 0.67


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
        level = float(np.median([shot.data for shot in self.shots]))
        apart = np.abs(self.mean - np.median(self.mean))
        if np.median(apart) > _ONLY_NOISE * _MEDIAN_DISTANCE * noise:
            return self.mean
        return np.where(apart > _HOT * noise, self.mean, np.float32(level))

    @property
    def changing(self) -> NDArray[np.float64]:
        """Share of the samples of each row that change from frame to frame, (rows,)."""
        data = [shot.data.reshape(len(shot.data), -1) for shot in self.shots]
        # A median, since one of the frames may be a copy.
        return np.asarray(np.median([(a != b).mean(axis=1) for a, b in pairwise(data)], axis=0))


def take_average(
    photographer: Photographer,
    image: NDArray[np.uint8],
    exposure: float | None = None,
    count: int = 4,
) -> AveragedFrame:
    """Photograph an image `count` times (at least 3), and average the frames that agree."""
    shots = _trusted_shots(photographer, image, exposure, count)
    stack = np.stack([shot.data for shot in shots]).astype(np.float32)
    middle = np.median(stack, axis=0)
    distance = np.sqrt(((stack - middle) ** 2).mean(axis=tuple(range(1, stack.ndim))))
    near = distance <= _OUTLIER * max(float(np.median(distance)), 1e-3)
    agreeing = stack[near]
    mean = agreeing.mean(axis=0)
    spread = agreeing - mean
    noise = float(np.sqrt((spread**2).sum() / max(1, (len(agreeing) - 1) * mean.size)))
    bright = agreeing.reshape(len(agreeing), -1).mean(axis=1)
    gain = float(bright.std() / max(float(bright.mean()), 1e-6))
    kept = [shot for shot, good in zip(shots, near, strict=True) if good]
    return AveragedFrame(mean.astype(np.float32), kept, noise, gain)


def _trusted_shots(
    photographer: Photographer, image: NDArray[np.uint8], exposure: float | None, count: int
) -> list[Shot]:
    shots: list[Shot] = []
    reason, hint = "", None
    silent = 0
    settle = None
    for _ in range(_TRIES * count):
        try:
            shots.append(photographer.take(image, exposure, settle))
        except UntrustedFrameError as error:
            reason, hint = error.message, error.hint
            silent += isinstance(error.__cause__, FrameTimeoutError)
            if silent == _SILENT and not shots:
                raise UnfitRigError(f"the camera gives no frames: {reason}", hint=hint) from error
        else:
            settle = min(photographer.settle, _AGAIN)
        if len(shots) == count:
            return shots
    raise UnfitRigError(
        f"of {_TRIES * count} frames of one image only {len(shots)} can be trusted; the last "
        f"of the others: {reason}",
        hint=hint or "look at the camera's picture with its own program, and at its cable",
    )
