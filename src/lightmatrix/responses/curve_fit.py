"""Fitting a camera's curve to pixels at several exposures, by OpenCV.

Debevec and Malik (1997) and Robertson, Borman and Stevenson (2003) find the light of each level up
to a common factor, because a pixel's light grows with the exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from lightmatrix.capture.frames import Frames
from lightmatrix.errors import InputError
from lightmatrix.files.extras import load_opencv

# Pixels that are seen at several exposures, in the levels 0 to 255 that OpenCV fits curves to.


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


METHODS = ("debevec", "robertson")
# Weight of the smoothness of Debevec's curve. tests/calibration/test_responses.py and
# `python -m benchmarks.response_curves` measure the errors that it leaves.
_SMOOTHNESS = 50.0
# Debevec's equations are solved as a dense system. These limit it: pixels along a side of a square
# of them, and equations (pixels times exposures).
_SIDE, _EQUATIONS = 17, 3000
# Pixels that Robertson's method gets; it takes longer with more.
_PIXELS = 10_000
# Robertson's iterations: the most, and the change of the curve at which they end.
_ITERATIONS, _TOLERANCE = 100, 1e-4
# Beyond the trusted levels, the curve goes on as the line through this many levels at its end.
_END = 12
# Residuals are averaged over this many ranges of light, of which each needs so many pixels.
_BINS, _FEWEST_IN_BIN = 16, 30


@dataclass(frozen=True, eq=False)
class Residuals:
    """How far the light of pixels departs from growing with the exposure."""

    # (n,): middle of each range of light.
    light: NDArray[np.float64]
    # (n,): mean over its pixels, as a share of full light.
    off: NDArray[np.float64]

    @property
    def largest(self) -> float:
        """The largest of them; NaN if there are none."""
        return float(np.abs(self.off).max()) if len(self.off) else float("nan")


def fit_curve(series: PixelSeries, method: str) -> NDArray[np.float64]:
    """Light of the levels 0 to 255: 0 without light, 1 at the clip level, never decreasing."""
    fitted = _debevec(series) if method == "debevec" else _robertson(series)
    low, high = series.lowest, series.highest
    levels = np.arange(TOP + 1)
    known = np.isfinite(fitted) & (fitted > 0) & (levels >= low) & (levels <= high)
    # Debevec's curve is smooth, so it also holds for levels that no pixel had.
    known &= np.isin(levels, series.values[series.trusted]) | (method == "debevec")
    light = np.interp(levels, levels[known], fitted[known])
    low, high = int(levels[known][0]), int(levels[known][-1])
    # Noise and clipping bend both ends of the curve, so straight lines replace them.
    end = slice(high - _END, high + 1)
    slope, start = np.polyfit(levels[end], light[end], 1)
    light[high:] = (start + slope * levels)[high:]
    light[: low + 1] = light[low] * np.clip((levels[: low + 1] - series.black), 0, None)
    light[: low + 1] /= low - series.black
    rising = np.asarray(isotonic_regression(light).x)
    return np.asarray(np.clip(rising / rising[-1], 0, 1))


def measure_residuals(curve: NDArray[np.float64], series: PixelSeries) -> Residuals:
    """How far each pixel's light is from growing with the exposure, over ranges of light."""
    light, times = curve[series.values], series.exposures[:, None]
    weight = series.trusted.astype(np.float64)
    per_exposure = (weight * light * times).sum(axis=0) / (weight * times**2).sum(axis=0)
    expected = per_exposure * times
    trusted = series.trusted & (expected <= 1)
    bins = np.minimum((expected[trusted] * _BINS).astype(int), _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    total = np.bincount(bins, (light - expected)[trusted], _BINS)
    keep = count >= _FEWEST_IN_BIN
    centre = (np.arange(_BINS) + 0.5) / _BINS
    return Residuals(centre[keep], total[keep] / count[keep])


def nearest_gamma(curve: NDArray[np.float64], series: PixelSeries) -> float:
    """The exponent of the power of the level that is nearest to a curve."""
    share = (np.arange(TOP + 1) - series.black) / (TOP - series.black)
    part = (share > 0.1) & (share < 0.99) & (curve > 0)
    log_light, log_level = np.log(curve[part]), np.log(share[part])
    return float((log_light @ log_level) / (log_level @ log_level))


def _debevec(series: PixelSeries) -> NDArray[np.float64]:
    cv2 = load_opencv("measuring a camera's response", "response")
    side = min(_SIDE, int(np.sqrt(_EQUATIONS / len(series.exposures))))
    some = series.some(side * side)
    # OpenCV takes its samples from a grid over the image; here the grid is the whole image.
    images = [np.ascontiguousarray(row.reshape(side, side)) for row in some.values]
    calibrate = cv2.createCalibrateDebevec(side * side, _SMOOTHNESS, False)
    curve = calibrate.process(images, some.exposures.astype(np.float32))
    return np.asarray(curve, np.float64).reshape(TOP + 1)


def _robertson(series: PixelSeries) -> NDArray[np.float64]:
    cv2 = load_opencv("measuring a camera's response", "response")
    some = series.some(_PIXELS)
    # OpenCV's implementation needs images of three channels.
    images = [np.repeat(row[None, :, None], 3, axis=2) for row in some.values]
    calibrate = cv2.createCalibrateRobertson(_ITERATIONS, _TOLERANCE)
    curve = calibrate.process(images, some.exposures.astype(np.float32))
    return np.asarray(curve, np.float64).reshape(TOP + 1, 3)[:, 0]
