"""Raw levels of a camera: their range, their checks, and values that differ from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError

# The highest raw level that is accepted. No camera counts further; a larger number is a typing
# error.
MOST_LEVEL = 2.0**32
# The least exposure. Samples are divided by it, and must stay within single precision (3e38).
_LEAST_EXPOSURE = 1e-30


def range_end(dtype: np.dtype[Any]) -> float:
    """The highest raw level that images of a type hold: 1 for float."""
    return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)


def per_frame(value: float | NDArray[Any], start: int, stop: int, name: str) -> NDArray[np.float64]:
    """The values of the frames start..stop, where `value` is one for all or one for each."""
    array = np.asarray(value, np.float64)
    if array.ndim == 0:
        return np.full(stop - start, array)
    if stop > len(array):
        raise InputError(f"{len(array)} {name} for {stop} frames", hint="give one for each frame")
    return array[start:stop]


def check_levels(
    clip: float | NDArray[Any] | None,
    black_level: float | NDArray[Any] | None,
    full_scale: float | None,
) -> None:
    """Refuse raw levels unless 0 <= black level < clip level <= full scale <= 2^32 in each frame.

    A level that is None is not known yet, and bounds nothing.
    """
    top = MOST_LEVEL if full_scale is None else full_scale
    if not 0 < top <= MOST_LEVEL:
        raise InputError(
            f"a full scale of {top:g}",
            hint=f"use the highest raw level, such as 255; at most {MOST_LEVEL:g}",
        )
    clips = np.asarray(np.inf if clip is None else clip, np.float64)
    if clip is not None and not ((clips > 0) & (clips <= top)).all():
        raise InputError(
            f"a clip level of {clips.min():g}", hint=f"use a raw level above 0 and at most {top:g}"
        )
    blacks = np.asarray(0.0 if black_level is None else black_level, np.float64)
    if blacks.ndim and clips.ndim and blacks.shape != clips.shape:
        raise InputError(
            f"{blacks.size} black levels, but {clips.size} clip levels",
            hint="give one number, or one for each frame",
        )
    if not ((blacks >= 0) & (blacks < clips)).all():
        highest = "" if clip is None else f" with a clip level of {clips.flat[0]:g}"
        raise InputError(
            f"a black level of {blacks.flat[0]:g}{highest}",
            hint="use a raw level of at least 0 and below the clip level",
        )


def check_exposures(exposure: float | NDArray[Any]) -> None:
    """Refuse exposures that are not positive, finite numbers, one or one for each frame."""
    values = np.asarray(exposure, np.float64)
    if values.ndim > 1 or not ((values >= _LEAST_EXPOSURE) & (values < np.inf)).all():
        raise InputError(f"an exposure of {values.min():g}", hint="use positive numbers, such as 1")
