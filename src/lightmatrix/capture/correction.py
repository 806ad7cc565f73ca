"""What a rig did to the samples of a capture, and how it is taken out as they are read."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.reprs import ShortRepr


@dataclass(frozen=True, eq=False, repr=False)
class Correction(ShortRepr):
    """The changes of K frames of R binned camera rows, as found by `fit_rig`.

    A sample becomes (sample - ambient) / (gain * profile) - added.

    Parameters
    ----------
    gain : (K,) float
        The light of each frame, as a factor.
    ambient : (K,) float
        Light that all camera pixels of a frame see, in units of the clip level at exposure 1.
    profile : (R, K) float, optional
        The light of each camera row in each frame, as a factor. None: 1.
    added : (M, K) float32, optional
        What the frames show more than they should, such as that of a moved picture.
    lag : (R,) int, optional
        How many frames late each camera row is: the sample of frame k is read in frame k + lag.
        Where there is none, it has no weight.
    """

    gain: NDArray[np.float64]
    ambient: NDArray[np.float64]
    profile: NDArray[np.float64] | None = None
    added: NDArray[np.floating] | None = None
    lag: NDArray[np.int64] | None = None

    def select(self, frames: NDArray[np.integer]) -> "Correction":
        """The correction of some frames, in this order."""
        return replace(
            self,
            gain=self.gain[frames],
            ambient=self.ambient[frames],
            profile=None if self.profile is None else self.profile[:, frames],
            added=None if self.added is None else self.added[:, frames],
        )

    def window(self, rows: slice, cols: slice, camera_shape: Sequence[int]) -> "Correction":
        """The correction of a rectangle of the binned camera pixels."""
        added = self.added
        if added is not None:
            part = added.reshape(*camera_shape, -1)[rows, cols]
            added = part.reshape(-1, part.shape[-1])
        return replace(
            self,
            profile=None if self.profile is None else self.profile[rows],
            added=added,
            lag=None if self.lag is None else self.lag[rows],
        )

    def applied(self, samples: Samples, start: int, camera_shape: Sequence[int]) -> Samples:
        """The samples of the camera samples from `start` on, corrected."""
        stop = start + samples.count
        row = np.arange(start, stop) // int(np.prod(camera_shape[1:]))
        values, level, clipped = samples.values, samples.clip_levels_of_all(), samples.clipped
        weights: NDArray[Any] | None = samples.weights
        if self.lag is not None:
            frames = np.arange(values.shape[1]) + self.lag[row][:, None]
            shown = (frames >= 0) & (frames < values.shape[1])
            frames = np.clip(frames, 0, values.shape[1] - 1)
            values, level, clipped, weights = (
                np.take_along_axis(each, frames, axis=1)
                for each in (values, level, clipped, samples.weights_of_all())
            )
            weights = weights * shown
        factor = self.gain if self.profile is None else self.gain * self.profile[row]
        added = 0 if self.added is None else self.added[start:stop]
        values, level = (
            ((each - self.ambient) / factor - added).astype(np.float32) for each in (values, level)
        )
        return Samples(values, clipped, level, weights)
