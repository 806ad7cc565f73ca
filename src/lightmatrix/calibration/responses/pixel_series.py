"""Pixels that are seen at several exposures, in the levels 0 to 255 that OpenCV fits curves to."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.frames import Frames
from lightmatrix.errors import InputError

# The level at which the camera clips, on the scale of these series.
TOP = 255
# Levels are trusted if they are this far from black and from the clip level, where noise and
# clipping bend the curve. Chosen by hand.
_FROM_BLACK, _FROM_CLIP = 4, 3
# Pixels of the photographs that are considered, and the fewest that have to be useful. Chosen by
# hand: more pixels only cost time, fewer leave levels without any pixel.
_MOST_PIXELS, _FEWEST_PIXELS = 40_000, 60
# The trusted levels have to span this share of the range from black to the clip level.
_LEAST_SPAN = 0.5
# Exposures of which one is less than this many times the other are not put in order.
_SAME_EXPOSURE = 1.01


@dataclass(frozen=True, eq=False)
class PixelSeries:
    """Levels of M pixels at K exposures."""

    # (K, M): levels, 255 being the clip level; pixels from dark to bright.
    values: NDArray[np.uint8]
    # (K,): relative to the longest.
    exposures: NDArray[np.float64]
    # Level without light, on the same scale.
    black: float

    @property
    def lowest(self) -> int:
        """The lowest trusted level."""
        return int(np.ceil(self.black)) + _FROM_BLACK

    @property
    def highest(self) -> int:
        """The highest trusted level."""
        return TOP - _FROM_CLIP

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Which levels are trusted, (K, M)."""
        return (self.values >= self.lowest) & (self.values <= self.highest)

    def some(self, count: int) -> PixelSeries:
        """`count` of the pixels, evenly from the darkest to the brightest."""
        places = np.linspace(0, self.values.shape[1] - 1, count).astype(int)
        values = np.ascontiguousarray(self.values[:, places])
        return PixelSeries(values, self.exposures, self.black)

    def parts(self, count: int) -> list[PixelSeries]:
        """`count` sets of different pixels, each from dark to bright."""
        return [
            PixelSeries(self.values[:, part::count], self.exposures, self.black)
            for part in range(count)
        ]


def sample_pixels(
    frames: Frames,
    exposures: NDArray[np.float64],
    *,
    clip: float,
    black: float,
    channel: int | None = None,
) -> PixelSeries:
    """Choose pixels of K photographs that are neither dark nor clipped at two exposures or more.

    `clip` and `black` are raw levels. All channels of a colour camera count as pixels unless one
    `channel` is chosen. An InputError says that there are too few pixels, or that the exposures of
    two photographs contradict their brightness.
    """
    pixels = np.arange(int(np.prod(frames.shape)))
    if channel is not None:
        pixels = pixels[channel :: frames.shape[2]]
    if len(pixels) > _MOST_PIXELS:
        pixels = np.random.default_rng(0).choice(pixels, _MOST_PIXELS, replace=False)
    raw = np.stack([frames.read(k).reshape(-1)[pixels] for k in range(frames.count)])
    values = np.rint(np.clip(raw / clip, 0, 1) * TOP).astype(np.uint8)
    series = PixelSeries(values, exposures / exposures.max(), TOP * black / clip)
    _check_order(frames, series)
    useful = series.trusted.sum(axis=0) >= 2
    if useful.sum() < _FEWEST_PIXELS:
        raise InputError(
            f"only {int(useful.sum())} of {len(pixels)} pixels are neither dark nor clipped at two "
            "exposures at least",
            hint="take more exposures in between, a factor of 2 apart, of a scene with dark and "
            "bright parts",
        )
    values = values[:, useful]
    trusted = values[series.trusted[:, useful]]
    span = (int(trusted.max()) - int(trusted.min())) / (TOP - series.black)
    if span < _LEAST_SPAN:
        raise InputError(
            f"the photographs show levels from {trusted.min() * clip / TOP:.0f} to "
            f"{trusted.max() * clip / TOP:.0f} of {clip:g} only",
            hint="take shorter and longer exposures too: some parts should be dark in the first, "
            "some clipped in the last",
        )
    order = np.argsort(values.mean(axis=0, dtype=np.float64), kind="stable")
    return PixelSeries(np.ascontiguousarray(values[:, order]), series.exposures, series.black)


def _check_order(frames: Frames, series: PixelSeries) -> None:
    """Refuse two photographs of which the one exposed for longer is the darker."""
    exposures = series.exposures
    for one, other in pairwise(np.argsort(exposures, kind="stable")):
        if exposures[other] < _SAME_EXPOSURE * exposures[one]:
            continue
        both = series.trusted[one] & series.trusted[other]
        darker = series.values[other][both] < series.values[one][both]
        if both.sum() >= _FEWEST_PIXELS and darker.mean() > 0.5:
            raise InputError(
                f"{frames.name(int(other))} is darker than {frames.name(int(one))}, though its "
                f"exposure is {exposures[other] / exposures[one]:.3g} times as long",
                hint="give the exposures in the order of the photographs",
            )
