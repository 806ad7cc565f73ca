"""The responses of a camera and of a projector, measured from photographs.

The camera's comes from photographs of one scene at several exposures: a pixel's light grows with
the exposure, which gives the light of each level up to a common factor (Debevec & Malik 1997). The
projector's comes from photographs of a ramp, each of one grey value all over.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix import pictures
from lightmatrix.capture.camera_curve import Response, nearest_gamma, range_end
from lightmatrix.capture.exposures import lit_samples, share_of_white
from lightmatrix.capture.frames import ArrayStack, Frames
from lightmatrix.errors import InputError
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.files.extras import exposure_time, load_opencv
from lightmatrix.files.images import read_image
from lightmatrix.files.kinds import PICTURE, RESPONSE
from lightmatrix.files.stacks import ImageStack
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.ranges import as_float, check_positive, real_array, real_numbers
from lightmatrix.reprs import ShortRepr

Photographs = str | Path | NDArray[Any]
# The level at which the camera clips, on the scale that OpenCV fits curves to; also the projector's
# grey value of white.
TOP = 255
# The fewest pixels that have to be useful: fewer leave levels without any. Chosen by hand.
_FEWEST_PIXELS = 60

# Photographs, and pixels of them that are seen at several exposures.


def exposures_of(frames: Frames, stated: float | NDArray[Any] | None) -> NDArray[np.float64]:
    """Exposure of each photograph, (K,): the stated ones, or those in the files of the camera."""
    if stated is None:
        paths = frames.paths if isinstance(frames, ImageStack) else ()
        times = [exposure_time(path) for path in paths if isinstance(path, Path)]
        if not times or None in times:
            which = f"{paths[times.index(None)]}: " if times else ""
            hint = "give the exposures, in any unit, in the order of the photographs"
            raise InputError(f"{which}the exposures of the photographs are unknown", hint=hint)
        return np.array(times, np.float64)
    exposures = np.atleast_1d(real_numbers("exposures", stated))
    if exposures.shape != (frames.count,):
        hint = "give one for each, in the order of the photographs"
        raise InputError(f"{exposures.size} exposures for {frames.count} photographs", hint=hint)
    if not (np.isfinite(exposures).all() and (exposures > 0).all()):
        hint = "use positive numbers, in any unit"
        raise InputError(f"an exposure of {exposures.min():g}", hint=hint)
    return exposures


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
        return int(np.ceil(self.black)) + 4

    @property
    def highest(self) -> int:
        """The highest trusted level."""
        return TOP - 3

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Which levels are trusted, (K, M): near both ends, noise and clipping bend the curve."""
        return (self.values >= self.lowest) & (self.values <= self.highest)


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
    if len(pixels) > 40_000:
        # More pixels only cost time.
        pixels = np.random.default_rng(0).choice(pixels, 40_000, replace=False)
    raw = np.stack([frames.read(k).reshape(-1)[pixels] for k in range(frames.count)])
    values = np.rint(np.clip(raw / clip, 0, 1) * TOP).astype(np.uint8)
    series = PixelSeries(values, exposures / exposures.max(), TOP * black / clip)
    for one, other in pairwise(np.argsort(exposures, kind="stable")):
        longer = exposures[other] / exposures[one]
        both = series.trusted[one] & series.trusted[other]
        darker = values[other][both] < values[one][both]
        # Nearly equal exposures have no order.
        if longer >= 1.01 and both.sum() >= _FEWEST_PIXELS and darker.mean() > 0.5:
            raise InputError(
                f"{frames.name(int(other))} is darker than {frames.name(int(one))}, though its "
                f"exposure is {longer:.3g} times as long",
                hint="give the exposures in the order of the photographs",
            )
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
    if span < 0.5:
        raise InputError(
            f"the photographs show levels from {trusted.min() * clip / TOP:.0f} to "
            f"{trusted.max() * clip / TOP:.0f} of {clip:g} only",
            hint="take shorter and longer exposures too: some parts should be dark in the first, "
            "some clipped in the last",
        )
    order = np.argsort(values.mean(axis=0, dtype=np.float64), kind="stable")
    return PixelSeries(np.ascontiguousarray(values[:, order]), series.exposures, series.black)


# The camera's curve.


def fit_curve(series: PixelSeries) -> NDArray[np.float64]:
    """Light of the levels 0 to 255: 0 without light, 1 at the clip level, never decreasing."""
    cv2 = load_opencv("measuring a camera's response", "response")
    # A dense system is solved, of about 3000 equations at most: pixels times exposures. OpenCV
    # takes its samples from a grid over the image; here the grid is the whole image.
    side = min(17, int(np.sqrt(3000 / len(series.exposures))))
    places = np.linspace(0, series.values.shape[1] - 1, side * side).astype(int)
    images = [np.ascontiguousarray(row[places].reshape(side, side)) for row in series.values]
    # The last number weighs smoothness. tests/responses/test_responses.py and
    # `python -m benchmarks.response_curves` measure the errors that it leaves.
    calibrate = cv2.createCalibrateDebevec(side * side, 50.0, False)
    curve = calibrate.process(images, series.exposures.astype(np.float32))
    fitted = np.asarray(curve, np.float64).reshape(TOP + 1, -1)[:, 0]
    low, high = series.lowest, series.highest
    levels = np.arange(TOP + 1)
    known = np.isfinite(fitted) & (fitted > 0) & (levels >= low) & (levels <= high)
    # The curve is smooth, so it also holds for levels that no pixel had.
    light = np.interp(levels, levels[known], fitted[known])
    low, high = int(levels[known][0]), int(levels[known][-1])
    # Noise and clipping bend both ends of the curve, so straight lines replace them; that of the
    # bright end goes through the last twelve trusted levels.
    end = slice(high - 12, high + 1)
    slope, start = np.polyfit(levels[end], light[end], 1)
    light[high:] = (start + slope * levels)[high:]
    light[: low + 1] = light[low] * np.clip((levels[: low + 1] - series.black), 0, None)
    light[: low + 1] /= low - series.black
    rising = np.asarray(scipy.optimize.isotonic_regression(light).x)
    return np.asarray(np.clip(rising / rising[-1], 0, 1))


def measure_residuals(curve: NDArray[np.float64], series: PixelSeries) -> NDArray[np.float64]:
    """How far light departs from growing with the exposure, (2, n).

    These are the middle of each of 16 ranges of light in which 30 pixels tell something, and the
    mean departure there, as shares of full light.
    """
    light, times = curve[series.values], series.exposures[:, None]
    weight = series.trusted.astype(np.float64)
    per_exposure = (weight * light * times).sum(axis=0) / (weight * times**2).sum(axis=0)
    expected = per_exposure * times
    trusted = series.trusted & (expected <= 1)
    bins = np.minimum((expected[trusted] * 16).astype(int), 15)
    count = np.bincount(bins, minlength=16)
    total = np.bincount(bins, (light - expected)[trusted], 16)
    keep = count >= 30
    return np.stack([(np.arange(16) + 0.5)[keep] / 16, total[keep] / count[keep]])


@dataclass(frozen=True, eq=False, repr=False)
class CameraResponse(ShortRepr):
    """A camera's measured response.

    Parameters
    ----------
    response : Response
        Level and light, both as a share of the clip level.
    uncertainty : float
        Twice the standard error of the light of a level, at the level where it is largest, as a
        share of full light: four curves of different pixels are averaged.
    misfit : float
        How far its light departs from being proportional to the exposure: the largest mean over 16
        ranges of light, as a share of full light. Above 0.02, something else has changed.
    gamma : float
        Exponent g for which level^g is nearest to the curve.
    exposures : (K,) float64
        Exposure of each photograph, in the unit in which they were given.
    channels : float, optional
        For a colour camera, the largest difference between the curves of its channels, in light.
    residuals : (2, n) float64
        Middles of the ranges of light, and the means of which `misfit` is the largest.
    """

    response: Response
    uncertainty: float
    misfit: float
    gamma: float
    exposures: NDArray[np.float64]
    channels: float | None
    residuals: NDArray[np.float64]

    def as_dict(self) -> dict[str, Any]:
        """Everything besides the curve, JSON-ready."""
        return {
            "uncertainty": round(self.uncertainty, 5),
            "misfit": round(self.misfit, 5),
            "gamma": round(self.gamma, 3),
            "difference_of_channels": None if self.channels is None else round(self.channels, 5),
            "exposures": [float(f"{value:.7g}") for value in self.exposures],
        }

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the curve as JSON, which `Response.parse` and capture.json read.

        Raises
        ------
        OutputError
            If a file of another kind is there or must not be replaced, or the disk fails.
        """
        levels, light, top = self.response.levels, self.response.light, self.response.full_scale
        assert levels is not None
        assert light is not None
        assert top is not None
        curve = CurveFile("camera", levels * top, light, self.as_dict())
        curve.save(path, overwrite=overwrite)


def camera_response(
    photographs: Photographs,
    exposures: float | NDArray[Any] | list[float] | None = None,
    *,
    black: str | Path | float | None = None,
    clip: float | None = None,
    output: str | Path | None = None,
    picture: str | Path | None = None,
    overwrite: bool = False,
) -> CameraResponse:
    """Measure a camera's response, as `lightmatrix response` does.

    Parameters
    ----------
    photographs : str, Path or array
        At least 3 photographs of one scene that does not change, the longest exposure at least 4
        times the shortest: a folder, a stack, or (K, rows, cols[, 3]) levels. The channels of a
        colour camera share one curve.
    exposures : (K,), optional
        Exposure of each in any unit. None: read from the files of the camera.
    black : str, Path or float, optional
        Photograph with the cap on, or the raw level without light. None: 0.
    clip : float, optional
        Raw level at which the camera clips, and where the curve ends. None: the end of the range
        of the files.
    output, picture : str or Path, optional
        A .json file of the curve and a .png picture of it to write.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    CameraResponse
        Its curve has 256 levels, to which images of 16 bits are rounded.

    Raises
    ------
    InputError
        If photographs cannot be read, exposures are too few, too similar or contradict the
        photographs, or too few pixels are between dark and clipped.
    MissingExtraError
        Without OpenCV, the extra `response`.
    OutputError
        If a file cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> light = np.geomspace(0.002, 1, 4000).reshape(50, 80)
    >>> exposures = [0.25, 0.5, 1, 2, 4]
    >>> photographs = [np.rint(255 * np.clip(e * light, 0, 1) ** (1 / 2.2)) for e in exposures]
    >>> levels = np.array(photographs, np.uint8)
    >>> measured = lm.camera_response(levels, exposures, output="curve.json")
    >>> round(measured.gamma, 1), lm.Response.parse("curve.json").full_scale
    (2.2, 255.0)
    """
    frames = _opened(photographs, output, picture, overwrite)
    times = exposures_of(frames, None if exposures is None else np.asarray(exposures))
    steps = np.unique(times)
    if len(steps) < 3 or steps[-1] < 4 * steps[0]:
        # These give the curve three points at each pixel, over two stops. Chosen by hand.
        raise InputError(
            f"{len(times)} photographs of {len(steps)} exposures from {steps[0]:g} to "
            f"{steps[-1]:g}",
            hint="take 3 exposures at least, better 7, each twice the one before",
        )
    check_positive(clip=clip)
    end = range_end(frames.dtype, clip)
    top = end if clip is None else as_float(clip)
    dark = as_float(np.median(read_image(black)) if isinstance(black, str | Path) else black or 0)
    if not 0 <= dark < 0.9 * top <= 0.9 * end:
        raise InputError(
            f"levels from {dark:g} without light to {top:g} where the camera clips, in images of "
            f"{frames.dtype}",
            hint="correct black or clip",
        )
    series = sample_pixels(frames, times, clip=top, black=dark)
    # Curves of four sets of different pixels are averaged; their spread is the uncertainty. Four
    # are the fewest whose spread tells anything, and each keeps enough pixels.
    parts = [PixelSeries(series.values[:, k::4], series.exposures, series.black) for k in range(4)]
    several = np.array([fit_curve(part) for part in parts])
    curve = several.mean(axis=0)
    by_channel = [
        fit_curve(sample_pixels(frames, times, clip=top, black=dark, channel=channel))
        for channel in range(frames.shape[2] if len(frames.shape) == 3 else 0)
    ]
    residuals = measure_residuals(curve, series)
    measured = CameraResponse(
        Response(np.arange(TOP + 1) / TOP, curve, "measured", top),
        float(several.std(axis=0, ddof=1).max()), float(max(abs(residuals[1]), default=np.nan)),
        nearest_gamma((np.arange(TOP + 1) - series.black) / (TOP - series.black), curve), times,
        max((float(np.abs(each - curve).max()) for each in by_channel), default=None), residuals,
    )  # fmt: skip
    if output is not None:
        measured.save(output, overwrite=overwrite)
    if picture is not None:
        share = np.linspace(0, 1, 256)
        points = top * share, measured.response.linearise(share)
        _draw(*points, measured.gamma, "camera", residuals).write(picture, overwrite=overwrite)
    return measured


# The projector's curve.


def projector_response(
    photographs: Photographs,
    levels: Sequence[float] | NDArray[Any] | None = None,
    *,
    response: Response | str | None = None,
    clip: float | None = None,
    output: str | Path | None = None,
    picture: str | Path | None = None,
    overwrite: bool = False,
) -> ProjectorResponse:
    """Measure a projector's response, as `lightmatrix response --projector` does.

    Parameters
    ----------
    photographs : str, Path or array
        At least 5 photographs at one exposure, each of one grey value all over the projector: a
        folder, a stack, or (K, rows, cols[, 3]) levels.
    levels : (K,), optional
        The grey values, whole numbers increasing from 0 to 255. None: evenly spaced.
    response : Response or str, optional
        The camera's response, see `Response.parse`. None: linear.
    clip : float, optional
        Raw level at which the camera clips. None: the end of the range of the files, or of the
        camera's response.
    output, picture : str or Path, optional
        A .json file of the curve and a .png picture of it to write.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    ProjectorResponse

    Raises
    ------
    InputError
        If photographs cannot be read, grey values do not fit them, or there is too little light.
    OutputError
        If a file cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> light = np.linspace(0, 1, 9)[:, None, None] ** 1.8 * np.full((9, 10, 10), 0.8)
    >>> measured = lm.projector_response(np.rint(250 * light + 5).astype(np.uint8))
    >>> round(measured.gamma, 1)
    1.8
    """
    frames = _opened(photographs, output, picture, overwrite)
    count = frames.count
    if count < 5:
        raise InputError(f"{count} photographs of grey values", hint="take 5 at least, better 17")
    even = np.rint(np.linspace(0, TOP, count))
    grey = even if levels is None else real_numbers("grey values", levels)
    if grey.shape != (count,):
        hint = "give one for each, in the order of the photographs"
        raise InputError(f"{grey.size} grey values for {count} photographs", hint=hint)
    whole = (grey == np.rint(grey)).all()
    if not whole or grey[0] != 0 or grey[-1] != TOP or (np.diff(grey) <= 0).any():
        hint = "give whole numbers that increase from 0 to 255, the photographs likewise"
        raise InputError(f"grey values from {grey[0]:g} to {grey[-1]:g}", hint=hint)
    check_positive(clip=clip)
    camera = response if isinstance(response, Response) else Response.parse(response or "linear")
    scale = camera.full_scale or range_end(frames.dtype, clip)
    ceiling = float(camera.linearise(np.array((clip or scale) / scale)))

    def light(index: int) -> NDArray[np.float64]:
        return camera.linearise(frames.read(index) / scale)

    black, white = light(0), light(count - 1)
    lit = lit_samples(white, black, ceiling)
    if lit.sum() < 20 or np.quantile(white - black, 0.99) < 0.02 * ceiling:
        raise InputError(
            f"{frames.name(count - 1)} has only {int(lit.sum())} pixels that the projector "
            "lights and that do not clip",
            hint="photograph the projected picture so that white is bright and does not clip, the "
            "darkest grey value first",
        )
    shares = np.array([share_of_white(light(k), white, black, lit) for k in range(count)])
    falls = np.flatnonzero(np.diff(shares) < -0.02)
    if len(falls):
        k = int(falls[0])
        raise InputError(
            f"{frames.name(k + 1)} is darker than {frames.name(k)}, though its grey value is "
            f"{grey[k + 1]:g} after {grey[k]:g}",
            hint="give the levels in the order of the photographs, from 0 to 255",
        )
    measured = ProjectorResponse.of_light(grey.astype(np.int64), shares)
    if output is not None:
        measured.save(output, overwrite=overwrite)
    if picture is not None:
        light_of_levels = np.array(measured.light)
        drawing = _draw(np.array(measured.levels), light_of_levels, measured.gamma, "projector")
        drawing.write(picture, overwrite=overwrite)
    return measured


def _opened(
    photographs: Photographs, output: str | Path | None, picture: str | Path | None, overwrite: bool
) -> Frames:
    """Photographs of files or of an array, once what comes of them is known to be writable."""
    for path, kind in ((output, RESPONSE), (picture, PICTURE)):
        if path is not None:
            check_output(path, kind, overwrite=overwrite)
    if isinstance(photographs, str | Path):
        return ImageStack.open(photographs)
    levels = real_array("photographs", photographs)
    if levels.ndim not in (3, 4) or levels.dtype not in (np.uint8, np.uint16, np.float32):
        hint = "give (K, rows, cols) or (K, rows, cols, 3) uint8, uint16 or float32"
        raise InputError(f"photographs of shape {levels.shape} and type {levels.dtype}", hint=hint)
    return ArrayStack(levels)


def _draw(
    levels: NDArray[Any],
    light: NDArray[np.float64],
    gamma: float,
    device: str,
    residuals: NDArray[np.float64] | None = None,
) -> "pictures.style.Picture":
    """The measured curve of a device beside known ones, and the residuals of a camera's."""
    count, colours = 1 if residuals is None else 2, pictures.style.COLOURS
    with pictures.style.figure(3.7 * count, 3.2) as drawing:
        curve, *others = drawing.subplots(1, count, squeeze=False)[0]
        style = "o-" if len(levels) < 100 else "-"
        curve.plot(levels, light, style, color=colours[0], markersize=4, label="measured")
        share = np.linspace(0, 1, 256)
        places = levels[-1] * share
        curve.plot(places, share, color="0.6", linewidth=1, label="linear")
        label = f"gamma {gamma:.2f}"
        curve.plot(places, share**gamma, ":", color=colours[1], linewidth=1.2, label=label)
        word = "grey value" if device == "projector" else "raw level"
        curve.set(xlabel=word, ylabel="light", title=f"Response of the {device}")
        curve.legend()
        for deviations in others:
            assert residuals is not None
            deviations.axhline(0, color="0.7", linewidth=0.8)
            middles, off = residuals
            deviations.plot(middles, 100 * off, "o-", color=colours[1], markersize=4)
            most = max(1.0, 120 * max(abs(off), default=0.0))
            deviations.set(
                xlabel="light", ylabel="% of full light", xlim=(0, 1), ylim=(-most, most),
                title="Light of a pixel, less what its exposure says",
            )  # fmt: skip
    return drawing
