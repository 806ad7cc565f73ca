"""The photographs that a response is measured from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.frames import ArrayStack, Frames
from lightmatrix.errors import InputError
from lightmatrix.files.extras import exposure_time
from lightmatrix.files.images import read_image
from lightmatrix.files.stacks import ImageStack

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
