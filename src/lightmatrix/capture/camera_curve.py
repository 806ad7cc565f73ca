"""The model of a camera's response, light by share of raw levels; and checks of raw levels.

`patterns/projector_curve.py` models the projector's; `calibration/responses/` measures both.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.files.numpy_files import read_npy
from lightmatrix.files.reading import read_text
from lightmatrix.ranges import as_float, check_type, real_numbers
from lightmatrix.reprs import ShortRepr

# Raw levels of a camera: their range, their checks, and values that differ from frame to frame.

# The highest raw level that is accepted. No camera counts further; a larger number is a typing
# error.
MOST_LEVEL = 2.0**32


def range_end(dtype: np.dtype[Any], clip: float | NDArray[Any] | None = None) -> float:
    """The highest raw level that images of a type hold: 1 for float, or a higher `clip` level."""
    if dtype.kind == "f":
        return float(np.max(1.0 if clip is None else clip, initial=1.0))
    return float(np.iinfo(dtype).max)


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
    top = MOST_LEVEL if full_scale is None else as_float(full_scale)
    if not 0 < top <= MOST_LEVEL:
        hint = f"use the highest raw level, such as 255; at most {MOST_LEVEL:g}"
        raise InputError(f"a full scale of {top:g}", hint=hint)
    clips = real_numbers("clip levels", np.inf if clip is None else clip)
    if clip is not None and not ((clips > 0) & (clips <= top)).all():
        hint = f"use a raw level above 0 and at most {top:g}"
        raise InputError(f"a clip level of {clips.min():g}", hint=hint)
    blacks = real_numbers("black levels", 0.0 if black_level is None else black_level)
    if blacks.ndim and clips.ndim and blacks.shape != clips.shape:
        hint = "give one number, or one for each frame"
        raise InputError(f"{blacks.size} black levels, but {clips.size} clip levels", hint=hint)
    if not ((blacks >= 0) & (blacks < clips)).all():
        highest = "" if clip is None else f" with a clip level of {clips.flat[0]:g}"
        hint = "use a raw level of at least 0 and below the clip level"
        raise InputError(f"a black level of {blacks.flat[0]:g}{highest}", hint=hint)


def check_exposures(exposure: float | NDArray[Any]) -> None:
    """Refuse exposures that are not positive, finite numbers, one or one for each frame."""
    values = real_numbers("exposures", exposure)
    # Samples are divided by it, and must stay within single precision (3e38).
    if values.ndim > 1 or not ((values >= 1e-30) & (values < np.inf)).all():
        raise InputError(f"an exposure of {values.min():g}", hint="use positive numbers, such as 1")


RESPONSES = "linear, gamma:2.2, srgb, auto, or a curve's file"
# The name of a response that `estimate` finds in the photographs; it is linear until then.
AUTOMATIC = "auto"
# Endings of file names that are read as a curve without ``curve:`` before them.
_CURVES = (".json", ".txt", ".csv", ".npy")


@dataclass(frozen=True, eq=False, repr=False)
class Response(ShortRepr):
    """The camera's response: which share of the full level belongs to which share of light.

    Parameters
    ----------
    levels, light : (n,) float64
        Matching points of the curve, from 0 to 1, levels increasing, light not decreasing;
        straight in between. None for the linear response.
    name : str
        The text that `parse` read.
    full_scale : float, optional
        Raw level of level 1, if the response was measured from raw levels. None: it fits any
        camera.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.Response.parse("gamma:2.2").name
    'gamma:2.2'
    """

    levels: NDArray[np.float64] | None = None
    light: NDArray[np.float64] | None = None
    name: str = "linear"
    full_scale: float | None = None

    @classmethod
    def parse(cls, text: str, folder: Path = Path()) -> "Response":
        """Read a response: ``linear``, ``gamma:2.2``, ``srgb``, ``auto`` or ``curve:FILE``.

        ``auto`` is linear until `estimate` finds the curve in the photographs.

        A curve is what `lightmatrix response` measured (.json); or a text file (or npy) of two
        columns, level and light, each from 0 to its own maximum; or of one column, the light at
        equally spaced levels. A relative FILE is looked for in `folder`. ``curve:`` may be left
        out before a name that ends in .json, .txt, .csv or .npy.

        Raises
        ------
        InputError
            On an unknown name, a gamma out of [0.1, 10], or a curve that does not increase or whose
            numbers are negative or too large.
        """
        check_type("a response", text, str, hint=f"give one of {RESPONSES}")
        kind, _, argument = text.partition(":")
        if text == "linear":
            return cls()
        if text == AUTOMATIC:
            return cls(name=text)
        # Straight lines between so many points are exact to 16 bits everywhere but near zero.
        levels = np.linspace(0, 1, 65536)
        if text == "srgb":
            light = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
            return cls(levels, light, text)
        if kind == "gamma":
            try:
                gamma = float(argument)
            except ValueError:
                gamma = np.nan
            if not 0.1 <= gamma <= 10:
                raise InputError(f"a response of {text!r}", hint="write for example gamma:2.2")
            return cls(levels, levels**gamma, text)
        if named := curve_file(text):
            file = folder / named
            try:
                if file.suffix.lower() == ".json":
                    curve = CurveFile.load(file, "camera")
                    top = float(curve.levels[-1])
                    return cls(curve.levels / top, curve.light, text, top)
                return cls(*_read_curve(file), text)
            except InputError as error:
                message = f"the response curve {error.message}"
                raise InputError(message, hint=error.hint) from error
        if text and (folder / text).is_dir():
            hint = f"use {RESPONSES}; a capture folder states its own response in capture.json"
            raise InputError(f"a response of {text!r}, which is a folder", hint=hint)
        raise InputError(f"a response of {text!r}", hint=f"use {RESPONSES}")

    @property
    def nameless(self) -> NDArray[np.float64] | None:
        """The points (n, 2) of a curve whose name does not say it; None if it does."""
        if self.levels is None or self.light is None or self.name == "srgb":
            return None
        if self.name.startswith("gamma:"):
            same = Response.parse(self.name).light
            if same is not None and np.array_equal(self.light, same):
                return None
        return np.column_stack([self.levels, self.light])

    def linearise(self, share: NDArray[Any]) -> NDArray[np.float64]:
        """Light, as a share of its maximum, at levels given as a share of theirs."""
        share = np.asarray(share, np.float64)
        if self.levels is None or self.light is None:
            return share
        return np.interp(share, self.levels, self.light)

    def of_full_scale(self, full_scale: float) -> "Response":
        """The same response with level 1 at `full_scale`, if it was measured from raw levels."""
        if self.full_scale in (None, full_scale) or self.levels is None or self.light is None:
            return self
        levels = self.levels * (self.full_scale / full_scale)
        inside = levels < 1
        end = np.interp(1, levels, self.light)
        light = np.append(self.light[inside], end) / end
        return replace(
            self, levels=np.append(levels[inside], 1), light=light, full_scale=full_scale
        )


def nearest_gamma(levels: NDArray[np.floating], light: NDArray[np.floating]) -> float:
    """The power of the level that is nearest to a curve; both are shares of full scale."""
    part = (levels > 0.1) & (levels < 0.99) & (light > 0)
    log_level, log_light = np.log(levels[part]), np.log(light[part])
    return float((log_light @ log_level) / (log_level @ log_level))


def curve_file(text: str) -> str | None:
    """The file that a response is read from, as it is written; None if it needs no file."""
    if text.startswith("curve:"):
        return text.removeprefix("curve:") or None
    return text if Path(text).suffix.lower() in _CURVES else None


def _read_curve(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Levels and light of a text or npy file, each as a share of its last value."""
    try:
        if file.suffix.lower() == ".npy":
            table = np.asarray(read_npy(file))
        else:
            text = read_text(file).replace(",", " ").replace(";", " ")
            rows = [line.split() for line in text.splitlines() if line.strip()]
            table = np.asarray([[float(v) for v in row] for row in rows if row[0][0] != "#"])
        if table.dtype.kind not in "fiu" or table.ndim not in (1, 2) or table.size == 0:
            raise ValueError("no table of numbers")
    except (OSError, EOFError, ValueError, TypeError) as error:
        # The message does not quote the file, which may be any file of the system.
        hint = "write two columns of numbers, level and light"
        raise InputError(f"{file}: cannot be read: no table of numbers", hint=hint) from error
    table = table.astype(np.float64).reshape(len(table), -1)
    if table.shape[1] == 1:
        table = np.column_stack([np.arange(len(table)), table[:, 0]])
    levels, light = table[:, 0], table[:, -1]
    increasing = len(table) > 1 and (np.diff(levels) > 0).all() and (np.diff(light) >= 0).all()
    positive = 0 <= levels[0] < levels[-1] <= MOST_LEVEL and 0 <= light[0] < light[-1] <= 1e30
    if table.shape[1] != 2 or not np.isfinite(table).all() or not (increasing and positive):
        raise InputError(
            f"{file}: {table.shape[0]} x {table.shape[1]} numbers that do not increase from 0 on",
            hint="write two columns, level and light, from dark to bright",
        )
    return levels / levels[-1], light / light[-1]
