"""Raw levels and values that may differ from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError

# No camera counts further; beyond it, numbers are slips of the pen.
MOST_LEVEL = 2.0**32


def range_end(dtype: np.dtype[Any]) -> float:
    """The highest raw level that images of a type hold: 1 for float."""
    return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)


def of_frames(value: float | NDArray[Any], start: int, stop: int, name: str) -> NDArray[np.float64]:
    """The values of the frames start..stop: one for all, or a list of one each."""
    array = np.asarray(value, np.float64)
    if array.ndim == 0:
        return np.full(stop - start, array)
    if stop > len(array):
        raise InputError(f"{len(array)} {name} for {stop} frames", hint="give one for each frame")
    return array[start:stop]


def check_levels(
    clip: float | NDArray[Any], black_level: float | NDArray[Any], full_scale: float
) -> None:
    """Refuse raw levels out of range.

    Raises
    ------
    InputError
        Unless 0 <= black level < clip level <= full scale <= 2^32 in every frame.
    """
    if not 0 < full_scale <= MOST_LEVEL:
        raise InputError(
            f"a full scale of {full_scale:g}",
            hint=f"use the highest raw level, such as 255; at most {MOST_LEVEL:g}",
        )
    clips, blacks = np.asarray(clip, np.float64), np.asarray(black_level, np.float64)
    if not (np.isfinite(clips).all() and (clips > 0).all() and (clips <= full_scale).all()):
        raise InputError(
            f"a clip level of {clips.min() if clips.size else clip:g}",
            hint=f"use a raw level above 0 and at most {full_scale:g}",
        )
    if not (np.isfinite(blacks).all() and (blacks >= 0).all() and (blacks < clips).all()):
        raise InputError(
            f"a black level of {blacks.flat[0]:g} with a clip level of {clips.flat[0]:g}",
            hint="use a raw level of at least 0 and below the clip level",
        )
