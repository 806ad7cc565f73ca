"""The camera's response: which share of the full level belongs to which share of light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.raw_levels import MOST_LEVEL
from lightmatrix.errors import InputError
from lightmatrix.files.curves import CurveFile
from lightmatrix.files.npy import read_npy
from lightmatrix.files.reading import read_text

# 65,536 levels of two numbers come to less than a tenth of it.
_MOST_CURVE = 16 << 20
# In whatever unit a curve counts its light; beyond it, numbers are slips of the pen.
_MOST_LIGHT = 1e30
_CURVES = (".json", ".txt", ".csv", ".npy")
RESPONSES = "linear, gamma:2.2, srgb, or a curve's file"


@dataclass(frozen=True, eq=False)
class Response:
    """The camera's response: which share of the full level belongs to which share of light.

    Parameters
    ----------
    levels, light : (n,) float64
        Matching points of the curve, from 0 to 1, levels increasing, light not decreasing;
        straight in between. None for the linear response.
    name : str
        As given to `parse`.
    full_scale : float, optional
        Raw level of level 1, where the response was measured of raw levels. None: of any camera.

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
    def parse(cls, text: str, folder: Path = Path()) -> Response:
        """Read a response: ``linear``, ``gamma:2.2``, ``srgb`` or ``curve:FILE``.

        A curve is what `lightmatrix response` measured (.json); or a text file (or npy) of two
        columns, level and light, each from 0 to its own maximum; or of one column, the light at
        equally spaced levels. A relative FILE is looked for in `folder`. Where it ends in .json,
        .txt, .csv or .npy, ``curve:`` may be left out.

        Raises
        ------
        InputError
            On an unknown name, a gamma out of [0.1, 10], or a curve that does not increase or whose
            numbers are negative or beyond all sense.
        """
        kind, _, argument = text.partition(":")
        if text == "linear":
            return cls()
        # Fine enough that the straight pieces are exact to 16 bits everywhere but near zero.
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
                    told = CurveFile.load(file, "camera")
                    top = float(told.levels[-1])
                    return cls(told.levels / top, told.light, text, top)
                return cls(*_read_curve(file), text)
            except InputError as error:
                # Which file is meant is clear from what it was asked for.
                message = f"the response curve {error.message}"
                raise InputError(message, hint=error.hint) from error
        raise InputError(f"a response of {text!r}", hint=f"use {RESPONSES}")

    def linearise(self, share: NDArray[Any]) -> NDArray[np.float64]:
        """Light, as a share of its maximum, at levels given as a share of theirs."""
        share = np.asarray(share, np.float64)
        if self.levels is None or self.light is None:
            return share
        return np.interp(share, self.levels, self.light)

    def of_full_scale(self, full_scale: float) -> Response:
        """The same response where level 1 is to be another raw level, if it knows its own."""
        if self.full_scale is None or self.full_scale == full_scale:
            return self
        if self.levels is None or self.light is None:
            return self
        levels = self.levels * (self.full_scale / full_scale)
        inside = levels < 1
        end = np.interp(1, levels, self.light)
        light = np.append(self.light[inside], end) / end
        return replace(
            self, levels=np.append(levels[inside], 1), light=light, full_scale=full_scale
        )


def curve_file(text: str) -> str | None:
    """The file that a response is read from, as it is written; None if from none."""
    if text.startswith("curve:"):
        return text.removeprefix("curve:") or None
    return text if Path(text).suffix.lower() in _CURVES else None


def _as_columns(values: Any) -> NDArray[np.float64]:
    """A table of points, (n, columns).

    Raises
    ------
    ValueError
        If it is empty, no numbers, or no table.
    """
    table = np.asarray(values)
    if table.dtype.kind not in "fiu" or table.ndim not in (1, 2) or table.size == 0:
        raise ValueError("no table of numbers")
    return table.astype(np.float64).reshape(len(table), -1)


def _read_curve(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # The message must not quote the file, which may be any of the system.
    unreadable = InputError(
        f"{file}: cannot be read: no table of numbers",
        hint="write two columns of numbers, level and light",
    )
    try:
        if file.suffix.lower() == ".npy":
            table = _as_columns(read_npy(file))
        else:
            text = read_text(file, _MOST_CURVE).replace(",", " ").replace(";", " ")
            rows = [line.split() for line in text.splitlines() if line.strip()]
            table = _as_columns([[float(v) for v in row] for row in rows if row[0][0] != "#"])
    except (OSError, EOFError, ValueError, TypeError) as error:
        raise unreadable from error
    if table.shape[1] == 1:
        table = np.column_stack([np.arange(len(table)), table[:, 0]])
    levels, light = table[:, 0], table[:, -1]
    increasing = len(table) > 1 and (np.diff(levels) > 0).all() and (np.diff(light) >= 0).all()
    if (
        table.shape[1] != 2
        or not np.isfinite(table).all()
        or not increasing
        or levels[-1] <= 0
        or light[-1] <= 0
    ):
        raise InputError(
            f"{file}: {table.shape[0]} x {table.shape[1]} numbers that do not increase",
            hint="write two columns, level and light, from dark to bright",
        )
    if levels[0] < 0 or levels[-1] > MOST_LEVEL or light[0] < 0 or light[-1] > _MOST_LIGHT:
        raise InputError(
            f"{file}: a response curve from level {levels[0]:g} to {levels[-1]:g} and light "
            f"{light[0]:g} to {light[-1]:g}",
            hint=f"give levels from 0 to {MOST_LEVEL:g} and light from 0 to {_MOST_LIGHT:g}",
        )
    return levels / levels[-1], light / light[-1]
