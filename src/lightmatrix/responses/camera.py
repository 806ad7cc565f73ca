"""The camera's response from photographs of one scene at several exposures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response, range_end
from lightmatrix.errors import InputError
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.files.kinds import PICTURE, RESPONSE
from lightmatrix.files.writing import check_output
from lightmatrix.reprs import short_repr
from lightmatrix.responses.curve_fit import (
    METHODS,
    TOP,
    Residuals,
    fit_curve,
    measure_residuals,
    nearest_gamma,
    sample_pixels,
)
from lightmatrix.responses.photographs import (
    Photographs,
    draw_camera_response,
    exposures_of,
    level_or_median,
    open_photographs,
)

# The fewest different exposures, and the least ratio of the longest to the shortest. Chosen by
# hand: they give the curve three points at each pixel, over two stops.
_FEWEST, _LEAST_RATIO = 3, 4
# Robertson's curve is not smooth, so it needs more exposures, each at most this many times the one
# before. Chosen by hand: with these, the levels that neighbouring exposures reach overlap.
_FEWEST_ROBERTSON, _MOST_STEP = 5, 2.2
# Curves of this many sets of different pixels are averaged; their spread is the uncertainty.
# Chosen by hand: four are the fewest whose spread tells anything, and each keeps enough pixels.
_PARTS = 4


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
        How far its light departs from being proportional to the exposure: the largest mean over 16
        ranges of light, as a share of full light. Above 0.02, something else has changed.
    gamma : float
        Exponent g for which level^g is nearest to the curve.
    method : str
        How the curve was fitted: "debevec" or "robertson".
    exposures : (K,) float64
        Exposure of each photograph, in the unit in which they were given.
    channels : float, optional
        For a colour camera, the largest difference between the curves of its channels, in light.
    residuals : Residuals
        The means of which `misfit` is the largest.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> from lightmatrix.responses.camera import CameraResponse
    >>> light = np.geomspace(0.002, 1, 4000).reshape(50, 80)
    >>> photographs = [np.rint(255 * np.clip(e * light, 0, 1)) for e in (0.25, 1, 4)]
    >>> measured = lm.camera_response(np.array(photographs, np.uint8), [0.25, 1, 4])
    >>> isinstance(measured, CameraResponse), abs(measured.gamma - 1) < 0.02
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
        """Everything besides the curve, JSON-ready."""
        return {
            "method": self.method,
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
        At least 3 photographs of one scene that does not change, the longest exposure at least 4
        times the shortest: a folder, a stack, or (K, rows, cols[, 3]) levels. The channels of a
        colour camera share one curve.
    exposures : (K,), optional
        Exposure of each in any unit. None: read from the files of the camera.
    method : {"debevec", "robertson"}
        Debevec's curve is smooth and needs few pixels; Robertson's is rough and follows bends.
    black : str, Path or float, optional
        Photograph with the cap on, or the raw level without light. None: 0.
    clip : float, optional
        Raw level at which the camera clips, and where the curve ends. None: the end of the range
        of the files.
    output : str or Path, optional
        A .json file of the curve to write.
    picture : str or Path, optional
        A .png picture of the curve to write.
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
    series = sample_pixels(frames, times, clip=top, black=dark)
    several = np.array([fit_curve(part, method) for part in series.parts(_PARTS)])
    curve = several.mean(axis=0)
    by_channel = [
        fit_curve(sample_pixels(frames, times, clip=top, black=dark, channel=channel), method)
        for channel in range(frames.shape[2] if len(frames.shape) == 3 else 0)
    ]
    residuals = measure_residuals(curve, series)
    measured = CameraResponse(
        Response(np.arange(TOP + 1) / TOP, curve, "measured", top),
        2 * float(several.std(axis=0, ddof=1).max()) / np.sqrt(_PARTS),
        residuals.largest,
        nearest_gamma(curve, series),
        method,
        times,
        max((float(np.abs(each - curve).max()) for each in by_channel), default=None),
        residuals,
    )
    if output is not None:
        measured.save(output, overwrite=overwrite)
    if picture is not None:
        drawing = draw_camera_response(measured.response, residuals, measured.gamma)
        drawing.write(picture, overwrite=overwrite)
    return measured


def _check_exposures(times: NDArray[np.float64], method: str) -> None:
    if len(np.unique(times)) < _FEWEST or times.max() < _LEAST_RATIO * times.min():
        raise InputError(
            f"{len(times)} photographs of {len(np.unique(times))} exposures from {times.min():g} "
            f"to {times.max():g}",
            hint=f"take {_FEWEST} exposures at least, better 7, each twice the one before",
        )
    steps = np.unique(times)
    if method == "robertson" and (
        len(steps) < _FEWEST_ROBERTSON or (steps[1:] / steps[:-1]).max() > _MOST_STEP
    ):
        raise InputError(
            f"Robertson's curve from {len(steps)} exposures from {steps[0]:g} to {steps[-1]:g}",
            hint=f"it needs {_FEWEST_ROBERTSON} at least, each about twice the one before; "
            "Debevec's needs fewer",
        )
