"""The photographs that a response is measured from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.frames import ArrayStack, Frames
from lightmatrix.errors import InputError
from lightmatrix.files.extras import exposure_time
from lightmatrix.files.images import read_image
from lightmatrix.files.stacks import ImageStack
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.pictures.style import COLOURS, STYLE
from lightmatrix.pictures.transport import Picture
from lightmatrix.responses.curve_fit import Residuals

# Pictures of measured responses: light over level, and how far to trust it.


def draw_camera_response(response: Response, residuals: Residuals, gamma: float) -> Picture:
    """A camera's curve beside known ones, and its residuals."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(7.2, 3.2), layout="constrained")
        curve, deviations = drawing.subplots(1, 2)
        top = response.full_scale or 1.0
        share = np.linspace(0, 1, 256)
        curve.plot(top * share, response.linearise(share), color=COLOURS[0], label="measured")
        _known(curve, top, gamma)
        curve.set(xlabel="raw level", ylabel="light", title="Response of the camera")
        curve.legend()
        deviations.axhline(0, color="0.7", linewidth=0.8)
        deviations.plot(residuals.light, 100 * residuals.off, "o-", color=COLOURS[1], markersize=4)
        most = max(1.0, 120 * residuals.largest)
        deviations.set(
            xlabel="light", ylabel="% of full light", xlim=(0, 1), ylim=(-most, most),
            title="Light of a pixel, less what its exposure says",
        )  # fmt: skip
    return drawing


def draw_projector_response(response: ProjectorResponse) -> Picture:
    """A projector's light over its grey values."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(3.8, 3.2), layout="constrained")
        curve = drawing.subplots()
        grey = np.linspace(0, 1, 256)
        curve.plot(255 * grey, response.light_of(grey), color=COLOURS[0], label="measured")
        curve.plot(response.levels, response.light, "o", color=COLOURS[0], markersize=4)
        _known(curve, 255.0, response.gamma)
        curve.set(xlabel="grey value", ylabel="light", title="Response of the projector")
        curve.legend()
    return drawing


def _known(axes: Any, top: float, gamma: float) -> None:
    share = np.linspace(0, 1, 256)
    axes.plot(top * share, share, color="0.6", linewidth=1, label="linear")
    axes.plot(
        top * share, share**gamma, ":", color=COLOURS[1], linewidth=1.2, label=f"gamma {gamma:.2f}"
    )


Photographs = str | Path | NDArray[Any]


def open_photographs(source: Photographs) -> Frames:
    """Open photographs of a folder or of a stack, or take an array (K, rows, cols[, 3])."""
    if isinstance(source, str | Path):
        return ImageStack.open(source)
    if source.ndim not in (3, 4) or source.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(
            f"photographs of shape {source.shape} and type {source.dtype}",
            hint="give (K, rows, cols) or (K, rows, cols, 3) uint8, uint16 or float32",
        )
    return ArrayStack(source)


def exposures_of(frames: Frames, stated: float | NDArray[Any] | None) -> NDArray[np.float64]:
    """Exposure of each photograph, (K,): the stated ones, or those in the files of the camera."""
    if stated is None:
        return _from_files(frames)
    exposures = np.atleast_1d(np.asarray(stated, np.float64))
    if exposures.shape != (frames.count,):
        raise InputError(
            f"{exposures.size} exposures for {frames.count} photographs",
            hint="give one for each, in the order of the photographs",
        )
    if not (np.isfinite(exposures).all() and (exposures > 0).all()):
        raise InputError(
            f"an exposure of {exposures.min():g}", hint="use positive numbers, in any unit"
        )
    return exposures


def level_or_median(black: str | Path | float | None) -> float:
    """The level without light: a number, the median of a photograph, or 0 for None."""
    if black is None:
        return 0.0
    if isinstance(black, int | float):
        return float(black)
    return float(np.median(read_image(black)))


def _from_files(frames: Frames) -> NDArray[np.float64]:
    paths = frames.paths if isinstance(frames, ImageStack) else ()
    times = [exposure_time(path) for path in paths if isinstance(path, Path)]
    if not times or None in times:
        which = f"{paths[times.index(None)]}: " if None in times else ""
        raise InputError(
            f"{which}the exposures of the photographs are unknown",
            hint="state them with --exposure 1,2,4,8, in any unit, in the order of the photographs",
        )
    return np.array(times, np.float64)
