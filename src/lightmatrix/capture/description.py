"""capture.json: the file that describes a capture, read strictly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import AUTOMATIC, RESPONSES, Response, curve_file
from lightmatrix.camera.raw_levels import MOST_LEVEL
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError
from lightmatrix.files.json_files import errors_naming, read_json
from lightmatrix.files.reading import within

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
