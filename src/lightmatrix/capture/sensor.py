"""The camera: from light to raw levels (exposure, noise, clipping, bits), and the way back.

Forward, for a camera sample that receives T p under a frame of exposure e:

    sample = e (T p) + noise           noise std = sqrt(read^2 + shot^2 e (T p))
    level  = round(black + min(1, sample) (clip - black))

and back, where f undoes the response (the identity for a linear camera):

    sample = (f(level) - f(black)) / (f(clip) - f(black)),    clipped where level >= clip

so 1.0 is always the clip level. The decoder then divides samples by their exposure.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import check_exposures, check_levels, per_frame
from lightmatrix.capture.decoder import Decoder
from lightmatrix.errors import InputError
from lightmatrix.ranges import check_number, check_seed
from lightmatrix.reprs import ShortRepr

# Bits of a raw level that simulated cameras can have.
BIT_DEPTHS = (8, 10, 12, 16)


@dataclass(frozen=True, eq=False, repr=False)
class Sensor(ShortRepr):
    """A linear camera that can be simulated.

    Parameters
    ----------
    exposure : float or (K,) array
        Exposure e of every frame, > 0, as a factor on T p.
    black_level : float
        Raw level of a sample without light, below `clip`.
    read_noise : float
        Standard deviation of the noise without light, in units of the clip level.
    shot_noise : float
        Standard deviation of the shot noise at the clip level, in units of the clip level; it
        grows with the root of the sample.
    bits : {8, 10, 12, 16} or None
        Bit depth; None means float32 levels in [0, 1] without quantisation.
    clip : float, optional
        Raw level at which the camera clips; None means the end of the range.

    Raises
    ------
    InputError
        On values out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.Sensor(exposure=2.0, bits=8).expose(np.array([[0.1, 0.25, 0.9]]))
    array([[ 51, 128, 255]], dtype=uint8)
    """

    exposure: float | NDArray[Any] = 1.0
    black_level: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0
    bits: int | None = 8
    clip: float | None = None

    def __post_init__(self) -> None:
        if self.bits is not None and self.bits not in BIT_DEPTHS:
            hint = f"use one of {', '.join(map(str, BIT_DEPTHS))}"
            raise InputError(f"a camera of {self.bits} bits", hint=hint)
        check_exposures(self.exposure)
        for name in ("read_noise", "shot_noise"):
            check_number(
                f"a {name.replace('_', ' ')}",
                getattr(self, name),
                most=1,
                hint="use a share of the clip level from 0 to 1, such as 0.003",
            )
        check_levels(self.clip_level, self.black_level, self.full_scale)

    @property
    def full_scale(self) -> float:
        """The highest raw level: 255, 1023, 4095, 65535, or 1 for float levels."""
        return 1.0 if self.bits is None else 2.0**self.bits - 1

    @property
    def clip_level(self) -> float:
        """The raw level at which the camera clips."""
        return self.full_scale if self.clip is None else self.clip

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the frames: uint8, uint16 or float32."""
        if self.bits is None:
            return np.dtype(np.float32)
        return np.dtype(np.uint8 if self.bits == 8 else np.uint16)

    def expose(
        self, irradiance: NDArray[Any], *, seed: int = 0, first_row: int = 0, first_frame: int = 0
    ) -> NDArray[Any]:
        """Photograph: from T p to raw levels.

        The noise of a sample depends only on `seed`, its frame and its row, so any division into
        tiles gives the same frames.

        Parameters
        ----------
        irradiance : (m, n) float
            T p of m camera samples under n patterns, in camera full scale at exposure 1.
        seed : int
            Seed of the noise, in [0, 2^64).
        first_row, first_frame : int
            Where this tile begins in the whole capture.

        Returns
        -------
        (m, n) uint8, uint16 or float32
            Raw levels.

        Raises
        ------
        InputError
            If there are more frames than exposures.
        """
        check_seed(seed)
        rows, frames = irradiance.shape
        exposure = per_frame(self.exposure, first_frame, first_frame + frames, "exposures")
        sample = np.asarray(irradiance, np.float64) * exposure
        if self.read_noise or self.shot_noise:
            deviation = np.sqrt(self.read_noise**2 + self.shot_noise**2 * sample.clip(0))
            for k in range(frames):
                sample[:, k] += deviation[:, k] * _normals(seed, first_frame + k, first_row, rows)
        top = self.clip_level
        level = self.black_level + np.minimum(sample, 1) * (top - self.black_level)
        if self.bits is None:
            return level.astype(np.float32)
        return np.rint(level).clip(0, np.floor(top)).astype(self.dtype)

    def decoder(self) -> Decoder:
        """The way back from this camera's levels."""
        clip = self.clip_level if self.bits is None else np.floor(self.clip_level)
        return Decoder(clip, self.full_scale, self.black_level, exposure=self.exposure)


def _normals(seed: int, frame: int, first: int, count: int) -> NDArray[np.float64]:
    """Standard normal numbers first..first + count of the endless sequence of (seed, frame)."""
    # One Philox counter yields four numbers. A tile can begin anywhere, because inverting the
    # distribution uses exactly one number for each sample; NumPy's ziggurat does not.
    skip = first % 4
    generator = np.random.Philox(counter=first // 4, key=np.array([seed, frame], np.uint64))
    raw = generator.random_raw(skip + count)[skip:]
    normals: NDArray[np.float64] = scipy.special.ndtri(((raw >> np.uint64(11)) + 0.5) * 2.0**-53)
    return normals
