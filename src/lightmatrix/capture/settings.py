"""`ReadSettings`: how the photographs of a capture are read; and capture.json, which says it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import (
    AUTOMATIC,
    MOST_LEVEL,
    RESPONSES,
    Response,
    check_exposures,
    check_levels,
    curve_file,
)
from lightmatrix.errors import InputError
from lightmatrix.files.reading import errors_naming, read_json, within
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.ranges import check_number
from lightmatrix.reprs import short_repr


@dataclass(frozen=True, eq=False)
class ReadSettings:
    """How the photographs of a capture are read.

    These are the options of the command line and the keys of capture.json. The defaults describe a
    linear camera at exposure 1 without black level.

    Parameters
    ----------
    black : str, Path or float, optional
        Photograph under a black pattern, which is subtracted. A number is a `black_level`.
    black_exposure : float, optional
        Exposure of the black frame, > 0. None: that of the frames, which must then be equal.
    black_level : float or (K,), optional
        Raw level without any light, the camera's electronic pedestal, >= 0. None: 0. It sets the
        unit of T, which the room light in a black frame does not change.
    white : str or Path, optional
        Photograph under a white pattern; becomes one more frame.
    clip : float or (K,), optional
        Raw level at which the camera clips, > 0. None: `full_scale`, or where a measured response
        ends.
    full_scale : float, optional
        Raw level that the response calls 1, > 0. None: the end of the range (255, 65535, or 1 for
        float).
    exposure : float or (K,)
        Exposure of each frame, > 0, in any unit; T is for exposure 1.
    response : Response or str, optional
        See `Response.parse`. None: linear, with a warning where the files say otherwise.
    projector_response : str, Path or ProjectorResponse, optional
        The light of the patterns' grey values, or "auto": `estimate` finds it in the photographs.
        None: proportional to them.
    mask : str or Path, optional
        Image that is 0 where camera pixels are left out. None: all count.
    mosaic : bool
        Whether each pixel of a raw camera file is a sample behind its colour of the filter, not
        interpolated to three channels.

    Raises
    ------
    InputError
        On levels and exposures out of range, and two black levels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> for k in range(8):
    ...     lm.write_image(f"photos/{k}.png", capture.frame(k))
    >>> settings = lm.ReadSettings(clip=250, black_level=4, response="linear")
    >>> lm.Capture.from_folders(capture.patterns, "photos", settings).decoder.clip
    250.0
    """

    black: str | Path | float | None = None
    black_exposure: float | None = None
    black_level: float | NDArray[Any] | None = None
    white: str | Path | None = None
    clip: float | NDArray[Any] | None = None
    full_scale: float | None = None
    exposure: float | NDArray[Any] = 1.0
    response: Response | str | None = None
    projector_response: str | Path | ProjectorResponse | None = None
    mask: str | Path | None = None
    mosaic: bool = False

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if isinstance(self.black, (int, float)):
            if self.black_level is not None:
                raise InputError(
                    f"black levels of {self.black:g} and {self.black_level}",
                    hint="give the black level once",
                )
            object.__setattr__(self, "black_level", float(self.black))
            object.__setattr__(self, "black", None)
        for name in ("black_level", "clip", "exposure"):
            value = getattr(self, name)
            if value is not None:
                levels = np.asarray(value, np.float64)
                object.__setattr__(self, name, levels if levels.ndim else float(levels))
        check_levels(self.clip, self.black_level, self.full_scale)
        check_exposures(self.exposure)
        if self.black_exposure is not None:
            check_number(
                "a black exposure", self.black_exposure, above=True,
                hint="use a positive number, in the unit of the frames' exposures",
            )  # fmt: skip


NAME = "capture.json"
# The file with the T that was photographed, in the folder of a simulated capture.
TRUTH = "truth.npz"
# The geometry of its rig and the exact depth at its camera pixels, beside the truth.
GEOMETRY, DEPTH = "geometry.json", "depth.tiff"
# Every capture.json states its format and version; a later version is refused.
FORMAT, VERSION = "lightmatrix-capture", 1

Levels = float | NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Description:
    """The content of capture.json; `absent` are the keys that it does not have at all."""

    settings: ReadSettings = field(default_factory=ReadSettings)
    projector_shape: tuple[int, ...] | None = None
    camera_shape: tuple[int, ...] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    absent: frozenset[str] = frozenset()


def read_description(file: Path, *, allow_outside: bool = False) -> Description:
    """Read a capture.json, whose files may lie outside its folder only with `allow_outside`."""
    return parse_description(file, read_json(file, FORMAT, VERSION), allow_outside=allow_outside)


def parse_description(
    file: Path, content: Mapping[str, Any], *, allow_outside: bool = False
) -> Description:
    """The description in the content of `file`, which messages name."""
    table = _Table(file, "", content, KEYS)
    black = table.get("black", _object, "an object with the black frame's file")
    frame = _Table(file, "black.", black or {}, _BLACK_KEYS)
    if black is not None and "file" not in black:
        raise InputError(f'{file}: "black" names no file', hint='add "file": "black.png" to it')

    def path(name: str | None) -> Path | None:
        if name is None:
            return None
        named = file.parent / name if allow_outside else within(file.parent, name, file)
        if named.is_dir():
            raise InputError(
                f"{file}: names {name!r}, which is a folder", hint="name a file of the folder"
            )
        return named

    response = table.get("response", _text, RESPONSES)
    if response is not None:
        path(curve_file(response))
    projector = table.get("projector_response", _text, "the name of a projector's curve, or auto")
    exposure = table.get("exposure", _several(_above_0), "a number above 0, or one for each frame")
    with errors_naming(file):
        settings = ReadSettings(
            black=path(frame.get("file", _text, "the name of an image")),
            black_exposure=frame.get("exposure", _above_0, "a number above 0"),
            black_level=table.get(
                "black_level", _several(_level), "a level of 0 or more, or one for each frame"
            ),
            clip=table.get("clip", _several(_above_0), "a level above 0, or one for each frame"),
            full_scale=table.get(
                "full_scale", _above_0, f"a level above 0, at most {MOST_LEVEL:g}"
            ),
            exposure=1.0 if exposure is None else exposure,
            response=None if response is None else Response.parse(response, file.parent),
            projector_response=projector if projector == AUTOMATIC else path(projector),
            mask=path(table.get("mask", _text, "the name of an image")),
            mosaic=bool(table.get("mosaic", _truth, "true or false")),
        )
    return Description(
        settings,
        table.get("projector_shape", _shape, "two whole numbers, such as [64, 64]"),
        table.get("camera_shape", _shape, "two or three whole numbers, such as [480, 640]"),
        table.get("provenance", _object, "an object; anything may stand in it") or {},
        KEYS - content.keys(),
    )


KEYS = frozenset(
    {"format", "version", "projector_shape", "camera_shape", "provenance", "mask", "black"}
    | {"exposure", "clip", "black_level", "full_scale", "response", "projector_response", "mosaic"}
)
_BLACK_KEYS = frozenset({"file", "exposure"})
# Keys whose value may be null, which states that the capture has none.
_NULL_IS_NONE = frozenset({"black", "mask", "provenance"})


@dataclass(frozen=True)
class _Table:
    """An object of the file, with messages that name its keys."""

    file: Path
    prefix: str
    content: Mapping[str, Any]
    keys: frozenset[str]

    def __post_init__(self) -> None:
        unknown = sorted(set(self.content) - self.keys)
        if unknown:
            names = ", ".join(repr((self.prefix + name)[:60]) for name in unknown[:5])
            raise InputError(
                f"{self.file}: does not know {names}",
                hint=f"its keys are {', '.join(sorted(self.prefix + key for key in self.keys))}",
            )

    def get(self, key: str, read: Callable[[Any], Any], expected: str) -> Any:
        """The value of a key as `read` returns it; None if it is absent, or null and may be."""
        if key not in self.content:
            return None
        value = self.content[key]
        if value is None and self.prefix + key in _NULL_IS_NONE:
            return None
        # For other keys a null is more likely a lost value than a wish for the default.
        result = None if value is None else read(value)
        if result is None:
            raise InputError(
                f'{self.file}: "{self.prefix}{key}" cannot be {_short(value)}',
                hint=f"give {expected}" + (", or leave it out" if value is None else ""),
            )
        return result


# The functions below return None for a value of another kind or out of range.


def _number(value: Any) -> float | None:
    # In Python True is a number, and whole numbers may exceed every float.
    if type(value) not in (int, float) or abs(value) > MOST_LEVEL:
        return None
    return float(value)


def _above_0(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _level(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number >= 0 else None


def _several(one: Callable[[Any], float | None]) -> Callable[[Any], Levels | None]:
    """One number, or a list of them."""

    def read(value: Any) -> Levels | None:
        if not isinstance(value, list):
            return one(value)
        numbers = [one(item) for item in value]
        return None if None in numbers or not numbers else np.array(numbers, np.float64)

    return read


def _shape(value: Any) -> tuple[int, ...] | None:
    whole = isinstance(value, list) and all(type(n) is int and n > 0 for n in value)
    return tuple(value) if whole and len(value) in (2, 3) else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value and "\0" not in value else None


def _truth(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _object(value: Any) -> dict[str, Any] | None:
    return value if isinstance(value, dict) else None


def _short(value: Any) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
