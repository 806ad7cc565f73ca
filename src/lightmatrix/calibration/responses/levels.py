"""Levels of the same camera pixels at all exposures, as the algorithms want them: 0 to 255."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.frames import Frames
from lightmatrix.errors import InputError

TOP = 255
# Nearer to black or to the clip level, noise and clipping bend what is seen.
_FROM_BLACK, _FROM_CLIP = 4, 3
_LOOKED_AT = 40_000
_FEWEST = 60
# Of the levels from black to the clip level, what photographs of trusted pixels must reach over.
_LEAST_RANGE = 0.5


@dataclass(frozen=True, eq=False)
class Levels:
    """Pixels at K exposures.

    Parameters
    ----------
    values : (K, M) uint8
        Levels, 255 being the clip level; brighter pixels further right.
    exposures : (K,) float64
        Relative to the longest.
    black : float
        Level without light, on the same scale.
    """

    values: NDArray[np.uint8]
    exposures: NDArray[np.float64]
    black: float

    @property
    def lowest(self) -> int:
        """The lowest level that is trusted."""
        return int(np.ceil(self.black)) + _FROM_BLACK

    @property
    def highest(self) -> int:
        """The highest level that is trusted."""
        return TOP - _FROM_CLIP

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Which levels are trusted, (K, M)."""
        return (self.values >= self.lowest) & (self.values <= self.highest)

    def some(self, count: int) -> Levels:
        """So many of the pixels, evenly from the darkest to the brightest."""
        places = np.linspace(0, self.values.shape[1] - 1, count).astype(int)
        return Levels(np.ascontiguousarray(self.values[:, places]), self.exposures, self.black)

    def parts(self, count: int) -> list[Levels]:
        """So many sets of different pixels, each from dark to bright."""
        return [
            Levels(self.values[:, part::count], self.exposures, self.black) for part in range(count)
        ]


def sample_levels(
    frames: Frames,
    exposures: NDArray[np.float64],
    *,
    clip: float,
    black: float,
    channel: int | None = None,
) -> Levels:
    """Pixels that at two exposures at least are neither dark nor clipped.

    Parameters
    ----------
    frames : Frames
        K photographs.
    exposures : (K,)
    clip, black : float
        Raw levels at which the camera clips, and without light.
    channel : int, optional
        Of a colour camera; None takes all of them as pixels of one.

    Raises
    ------
    InputError
        If there are too few, or the exposures of two photographs contradict what is seen.
    """
    size = int(np.prod(frames.shape))
    every = np.arange(size)
    if channel is not None:
        every = every[channel :: frames.shape[2]]
    if len(every) > _LOOKED_AT:
        every = np.random.default_rng(0).choice(every, _LOOKED_AT, replace=False)
    raw = np.stack([frames.read(k).reshape(-1)[every] for k in range(frames.count)])
    values = np.rint(np.clip(raw / clip, 0, 1) * TOP).astype(np.uint8)
    scaled = exposures / exposures.max()
    found = Levels(values, scaled, TOP * black / clip)
    _check_order(frames, found)
    keep = found.trusted.sum(axis=0) >= 2
    if keep.sum() < _FEWEST:
        raise InputError(
            f"only {int(keep.sum())} of {len(every)} pixels are neither dark nor clipped at two "
            "exposures at least",
            hint="take more exposures in between, a factor of 2 apart, of a scene with dark and "
            "bright parts",
        )
    values = values[:, keep]
    reached = values[found.trusted[:, keep]]
    share = (int(reached.max()) - int(reached.min())) / (TOP - found.black)
    if share < _LEAST_RANGE:
        raise InputError(
            f"the photographs show levels from {reached.min() * clip / TOP:.0f} to "
            f"{reached.max() * clip / TOP:.0f} of {clip:g} only",
            hint="take shorter and longer exposures too: some parts should be dark in the first, "
            "some clipped in the last",
        )
    order = np.argsort(values.mean(axis=0, dtype=np.float64), kind="stable")
    return Levels(np.ascontiguousarray(values[:, order]), scaled, found.black)


def _check_order(frames: Frames, found: Levels) -> None:
    """Refuse photographs of which the longer exposed one is the darker."""
    order = np.argsort(found.exposures, kind="stable")
    for one, other in pairwise(order):
        if found.exposures[other] < 1.01 * found.exposures[one]:
            continue
        both = found.trusted[one] & found.trusted[other]
        darker = found.values[other][both] < found.values[one][both]
        if both.sum() >= _FEWEST and darker.mean() > 0.5:
            raise InputError(
                f"{frames.name(int(other))} is darker than {frames.name(int(one))}, though its "
                f"exposure is {found.exposures[other] / found.exposures[one]:.3g} times as long",
                hint="give the exposures in the order of the photographs",
            )
