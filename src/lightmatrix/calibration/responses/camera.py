"""The camera's response from photographs of one scene at several exposures.

Debevec and Malik (1997) and Robertson, Borman and Stevenson (2003), as OpenCV has them, find the
light of each level up to a factor: a pixel's light grows with the exposure, whatever it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from lightmatrix.calibration.responses.levels import TOP, Levels, sample_levels
from lightmatrix.calibration.responses.photographs import (
    Photographs,
    exposures_of,
    level_or_median,
    open_photographs,
)
from lightmatrix.calibration.responses.pictures import Residuals, draw_camera_response
from lightmatrix.camera.camera_curve import Response
from lightmatrix.camera.raw_levels import range_end
from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.outputs.kinds import PICTURE, RESPONSE
from lightmatrix.outputs.writing import check_output
from lightmatrix.reprs import short_repr

METHODS = ("debevec", "robertson")
# The fewest exposures, and the least ratio of the longest to the shortest.
_FEWEST, _LEAST_RATIO = 3, 4
# Robertson's curve has no smoothness to bridge longer steps, nor to do without many of them.
_FEWEST_ROUGH, _MOST_STEP = 5, 2.2
# How smooth Debevec's curve is; measured in tests/calibration/test_responses.py.
_SMOOTH = 50.0
# Debevec's system is solved as a dense one: pixels (of a side) and equations at most. Pixels for
# Robertson's. Several of them, of different pixels, are averaged, and tell how well they are known.
_SIDE, _EQUATIONS, _PIXELS, _PARTS = 17, 3000, 10_000, 4
# Levels at either end of the trusted ones by which the curve is continued.
_END = 12
_BINS, _FEWEST_IN_BIN = 16, 30


@dataclass(frozen=True, eq=False)
class CameraResponse:
    """A camera's measured response.

    Parameters
    ----------
    response : Response
        Level and light, both as a share of the clip level.
    uncertainty : float
        Twice the standard error of the light of a level, at the level where it is largest, as a
        share of full light: four curves of different pixels are averaged.
    misfit : float
        How far the light that it gives departs from growing with the exposure: the largest mean
        over 16 ranges of light, as a share of full light. Above 0.02, something else has changed.
    gamma : float
        The power of the level that comes nearest.
    method : str
    exposures : (K,) float64
        As they were used.
    channels : float, optional
        Of a colour camera: the largest difference between the curves of its channels, in light.
    residuals : Residuals
        What `misfit` is the largest of.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> light = np.geomspace(0.002, 1, 4000).reshape(50, 80)
    >>> photographs = [np.rint(255 * np.clip(e * light, 0, 1)) for e in (0.25, 1, 4)]
    >>> found = lm.camera_response(np.array(photographs, np.uint8), [0.25, 1, 4])
    >>> isinstance(found, lm.CameraResponse), abs(found.gamma - 1) < 0.02
    (True, True)
    """

    response: Response
    uncertainty: float
    misfit: float
    gamma: float
    method: str
    exposures: NDArray[np.float64]
    channels: float | None
    residuals: Residuals

    __repr__ = short_repr

    def as_dict(self) -> dict[str, Any]:
        """What is known besides the curve, JSON-ready."""
        return {
            "method": self.method,
            "uncertainty": round(self.uncertainty, 5),
            "misfit": round(self.misfit, 5),
            "gamma": round(self.gamma, 3),
            "difference_of_channels": None if self.channels is None else round(self.channels, 5),
            "exposures": [float(f"{value:.7g}") for value in self.exposures],
        }

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the curve as JSON, which `Response.parse` and capture.json take.

        Raises
        ------
        OutputError
            If there is a file that is no response or must not be replaced, or the disk fails.
        """
        levels, light, top = self.response.levels, self.response.light, self.response.full_scale
        assert levels is not None
        assert light is not None
        assert top is not None
        told = CurveFile("camera", levels * top, light, self.as_dict())
        told.save(path, overwrite=overwrite)


def camera_response(
    photographs: Photographs,
    exposures: float | NDArray[Any] | list[float] | None = None,
    *,
    method: str = "debevec",
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
        At least 3 photographs of one scene that does not change, at exposures whose longest is 4
        times the shortest or more: a folder, a stack, or (K, rows, cols[, 3]) levels. Channels of a
        colour camera are taken to have one curve.
    exposures : (K,), optional
        Exposure of each in any unit; None: as the camera wrote it into the files.
    method : {"debevec", "robertson"}
        Debevec's curve is smooth and needs few pixels; Robertson's is not, and follows bends.
    black : str, Path or float, optional
        Photograph with the cap on, or the raw level without light; None: 0.
    clip : float, optional
        Raw level at which the camera clips, and the largest of the curve; None: the end of the
        range of the files.
    output : str or Path, optional
        A .json file of the curve to write as well.
    picture : str or Path, optional
        A .png picture of it to write as well.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    CameraResponse
        Its curve has 256 levels; images of 16 bits are rounded to as many for it.

    Raises
    ------
    InputError
        On photographs that cannot be read, too few or too alike exposures, ones that contradict
        the photographs, or too few pixels between dark and clipped.
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
    >>> found = lm.camera_response(np.array(photographs, np.uint8), exposures, output="curve.json")
    >>> round(found.gamma, 1), lm.Response.parse("curve.json").full_scale
    (2.2, 255.0)
    """
    if method not in METHODS:
        raise InputError(f"a method {method!r}", hint=f"use {' or '.join(METHODS)}")
    for path, kind in ((output, RESPONSE), (picture, PICTURE)):
        if path is not None:
            check_output(path, kind, overwrite=overwrite)
    frames = open_photographs(photographs)
    times = exposures_of(frames, None if exposures is None else np.asarray(exposures))
    _check_exposures(times, method)
    end = range_end(frames.dtype)
    top = end if clip is None else float(clip)
    dark = level_or_median(black)
    if not 0 <= dark < 0.9 * top <= 0.9 * end:
        raise InputError(
            f"levels from {dark:g} without light to {top:g} where the camera clips, in images of "
            f"{frames.dtype}",
            hint="correct --black or --clip",
        )
    levels = sample_levels(frames, times, clip=top, black=dark)
    several = np.array([_curve(part, method) for part in levels.parts(_PARTS)])
    curve = several.mean(axis=0)
    of_channels = [
        _curve(sample_levels(frames, times, clip=top, black=dark, channel=channel), method)
        for channel in range(frames.shape[2] if len(frames.shape) == 3 else 0)
    ]
    residuals = _residuals(curve, levels)
    grid = np.arange(TOP + 1) / TOP
    found = CameraResponse(
        Response(grid, curve, "measured", top),
        2 * float(several.std(axis=0, ddof=1).max()) / np.sqrt(_PARTS),
        residuals.largest,
        _gamma(curve, levels),
        method,
        times,
        max((float(np.abs(each - curve).max()) for each in of_channels), default=None),
        residuals,
    )
    if output is not None:
        found.save(output, overwrite=overwrite)
    if picture is not None:
        drawing = draw_camera_response(found.response, residuals, found.gamma)
        drawing.write(picture, overwrite=overwrite)
    return found


def _check_exposures(times: NDArray[np.float64], method: str) -> None:
    if len(np.unique(times)) < _FEWEST or times.max() < _LEAST_RATIO * times.min():
        raise InputError(
            f"{len(times)} photographs of {len(np.unique(times))} exposures from {times.min():g} "
            f"to {times.max():g}",
            hint=f"take {_FEWEST} exposures at least, better 7, each twice the one before",
        )
    steps = np.unique(times)
    if method == "robertson" and (
        len(steps) < _FEWEST_ROUGH or (steps[1:] / steps[:-1]).max() > _MOST_STEP
    ):
        raise InputError(
            f"Robertson's curve from {len(steps)} exposures from {steps[0]:g} to {steps[-1]:g}",
            hint=f"it needs {_FEWEST_ROUGH} at least, each about twice the one before; Debevec's "
            "does with fewer",
        )


def _curve(levels: Levels, method: str) -> NDArray[np.float64]:
    """Light of the levels 0 to 255: 0 without light, 1 at the clip level, never decreasing."""
    raw = _debevec(levels) if method == "debevec" else _robertson(levels)
    low, high = levels.lowest, levels.highest
    every = np.arange(TOP + 1)
    known = np.isfinite(raw) & (raw > 0) & (every >= low) & (every <= high)
    seen = np.isin(every, levels.values[levels.trusted])
    # Between levels that no pixel had, and beyond them, Debevec's curve goes on smoothly.
    known &= seen | (method == "debevec")
    light = np.interp(every, every[known], raw[known])
    low, high = int(every[known][0]), int(every[known][-1])
    # Near black and the clip level noise and clipping bend it: straight on instead.
    light[high:] = _continued(every, light, slice(high - _END, high + 1))[high:]
    light[: low + 1] = light[low] * np.clip((every[: low + 1] - levels.black), 0, None)
    light[: low + 1] /= low - levels.black
    rising = np.asarray(isotonic_regression(light).x)
    return np.asarray(np.clip(rising / rising[-1], 0, 1))


def _continued(
    every: NDArray[np.int64], light: NDArray[np.float64], part: slice
) -> NDArray[np.float64]:
    slope, start = np.polyfit(every[part], light[part], 1)
    return np.asarray(start + slope * every)


def _debevec(levels: Levels) -> NDArray[np.float64]:
    cv2 = _opencv()
    side = min(_SIDE, int(np.sqrt(_EQUATIONS / len(levels.exposures))))
    some = levels.some(side * side)
    # OpenCV takes its samples from a grid over the image, here from every pixel of it.
    images = [np.ascontiguousarray(row.reshape(side, side)) for row in some.values]
    calibrate = cv2.createCalibrateDebevec(side * side, _SMOOTH, False)
    found = calibrate.process(images, some.exposures.astype(np.float32))
    return np.asarray(found, np.float64).reshape(TOP + 1)


def _robertson(levels: Levels) -> NDArray[np.float64]:
    cv2 = _opencv()
    some = levels.some(_PIXELS)
    # Images of one channel break it.
    images = [np.repeat(row[None, :, None], 3, axis=2) for row in some.values]
    calibrate = cv2.createCalibrateRobertson(100, 1e-4)
    found = calibrate.process(images, some.exposures.astype(np.float32))
    return np.asarray(found, np.float64).reshape(TOP + 1, 3)[:, 0]


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError(
            "measuring a camera's response needs OpenCV",
            hint='install the extra: pip install "lightmatrix[response]"',
        ) from error
    return cv2


def _residuals(curve: NDArray[np.float64], levels: Levels) -> Residuals:
    """How far each pixel's light is from growing with the exposure, over ranges of light."""
    light, times = curve[levels.values], levels.exposures[:, None]
    weight = levels.trusted.astype(np.float64)
    each = (weight * light * times).sum(axis=0) / (weight * times**2).sum(axis=0)
    expected = each * times
    trusted = levels.trusted & (expected <= 1)
    place = np.minimum((expected[trusted] * _BINS).astype(int), _BINS - 1)
    off = (light - expected)[trusted]
    count = np.bincount(place, minlength=_BINS)
    total = np.bincount(place, off, _BINS)
    keep = count >= _FEWEST_IN_BIN
    centre = (np.arange(_BINS) + 0.5) / _BINS
    return Residuals(centre[keep], total[keep] / count[keep])


def _gamma(curve: NDArray[np.float64], levels: Levels) -> float:
    share = (np.arange(TOP + 1) - levels.black) / (TOP - levels.black)
    part = (share > 0.1) & (share < 0.99) & (curve > 0)
    bent, value = np.log(curve[part]), np.log(share[part])
    return float((bent @ value) / (value @ value))
