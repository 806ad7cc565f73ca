"""`ReadSettings`: how the photographs of a capture are read; and capture.json, which says it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture import camera_curve as curves
from lightmatrix.errors import InputError
from lightmatrix.files.reading import errors_naming, read_json, within
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.ranges import as_float, check_number, real_numbers
from lightmatrix.reprs import ShortRepr


@dataclass(frozen=True, eq=False, repr=False)
class ReadSettings(ShortRepr):
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
    clip : float, (K,) or "auto", optional
        Raw level at which the camera clips, > 0; "auto" takes the level at which samples pile up,
        if there is one. None: `full_scale`, or where a measured response ends.
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
    clip: float | NDArray[Any] | Literal["auto"] | None = None
    full_scale: float | None = None
    exposure: float | NDArray[Any] = 1.0
    response: curves.Response | str | None = None
    projector_response: str | Path | ProjectorResponse | None = None
    mask: str | Path | None = None
    mosaic: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.black, (int, float)):
            if self.black_level is not None:
                raise InputError(
                    f"black levels of {self.black:g} and {self.black_level}",
                    hint="give the black level once",
                )
            object.__setattr__(self, "black_level", as_float(self.black))
            object.__setattr__(self, "black", None)
        for name in ("black_level", "clip", "exposure"):
            value = getattr(self, name)
            automatic = name == "clip" and isinstance(value, str) and value == curves.AUTOMATIC
            if value is not None and not automatic:
                levels = real_numbers(name.replace("_", " "), value)
                object.__setattr__(self, name, levels if levels.ndim else float(levels))
        clip = None if isinstance(self.clip, str) else self.clip
        curves.check_levels(clip, self.black_level, self.full_scale)
        curves.check_exposures(self.exposure)
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
    projectors: tuple[tuple[int, int], ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    absent: frozenset[str] = frozenset()


def read_description(file: Path, *, allow_outside: bool = False) -> Description:
    """Read a capture.json, whose files may lie outside its folder only with `allow_outside`."""
    content = read_json(file, FORMAT, VERSION)
    values = _read(file, content, KEYS)
    black = values["black"]
    frame = _read(file, black or {}, _BLACK_KEYS, "black.")
    if black is not None and "file" not in black:
        raise InputError(f'{file}: "black" names no file', hint='add "file": "black.png" to it')

    def path(name: str | None) -> Path | None:
        if name is None:
            return None
        named = file.parent / name if allow_outside else within(file.parent, name, file)
        if named.is_dir():
            hint = "name a file of the folder"
            raise InputError(f"{file}: names {name!r}, which is a folder", hint=hint)
        return named

    response, projector = values["response"], values["projector_response"]
    if response is not None:
        path(curves.curve_file(response))
    with errors_naming(file):
        settings = ReadSettings(
            black=path(frame["file"]), black_exposure=frame["exposure"],
            black_level=values["black_level"], clip=values["clip"], full_scale=values["full_scale"],
            exposure=1.0 if values["exposure"] is None else values["exposure"],
            response=None if response is None else curves.Response.parse(response, file.parent),
            projector_response=projector if projector == curves.AUTOMATIC else path(projector),
            mask=path(values["mask"]), mosaic=bool(values["mosaic"]),
        )  # fmt: skip
    absent = frozenset(KEYS.keys() - content.keys())
    shapes = values["projector_shape"], values["camera_shape"]
    projectors = values["projectors"] or ()
    return Description(settings, *shapes, projectors, values["provenance"] or {}, absent)


# How a value is read, to None if it is of another kind or out of range; and what may stand there.
_Kind = tuple[Callable[[Any], Any], str]


def _read(
    file: Path, content: Mapping[str, Any], kinds: Mapping[str, _Kind], prefix: str = ""
) -> dict[str, Any]:
    """The values of an object of the file as they are read; None for keys that it does not have."""
    if unknown := sorted(set(content) - set(kinds)):
        names = ", ".join(repr((prefix + name)[:60]) for name in unknown[:5])
        hint = f"its keys are {', '.join(sorted(prefix + key for key in kinds))}"
        raise InputError(f"{file}: does not know {names}", hint=hint)
    values = {}
    for key, (read, expected) in kinds.items():
        value = content.get(key)
        values[key] = None if value is None else read(value)
        # Null may state that the capture has none. For other keys it is more likely a lost value
        # than a wish for the default.
        none = value is None and prefix + key in ("black", "mask", "provenance")
        if key in content and values[key] is None and not none:
            hint = f"give {expected}" + (", or leave it out" if value is None else "")
            shown = "null" if value is None else repr(value)
            shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
            raise InputError(f'{file}: "{prefix}{key}" cannot be {shown}', hint=hint)
    return values


def _number(value: Any) -> float | None:
    # In Python True is a number, and whole numbers may exceed every float.
    if type(value) not in (int, float) or abs(value) > curves.MOST_LEVEL:
        return None
    return float(value)


def _above_0(value: Any) -> float | None:
    return number if (number := _number(value)) is not None and number > 0 else None


def _several(value: Any) -> Levels | None:
    """One number of 0 or more, or a list of them; `ReadSettings` checks them further."""
    numbers = [_number(item) for item in (value if isinstance(value, list) else [value])]
    if not numbers or any(number is None or number < 0 for number in numbers):
        return None
    return np.array(numbers, np.float64) if isinstance(value, list) else numbers[0]


def _clip(value: Any) -> Levels | str | None:
    return curves.AUTOMATIC if value == curves.AUTOMATIC else _several(value)


def _shape(value: Any) -> tuple[int, ...] | None:
    whole = isinstance(value, list) and all(type(n) is int and n > 0 for n in value)
    return tuple(value) if whole and len(value) in (2, 3) else None


def _sizes(value: Any) -> tuple[tuple[int, ...], ...] | None:
    sizes = [_shape(size) for size in value] if isinstance(value, list) else []
    good = len(sizes) > 1 and all(size is not None and len(size) == 2 for size in sizes)
    return tuple(size for size in sizes if size) if good else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value and "\0" not in value else None


def _of(kind: type) -> Callable[[Any], Any]:
    return lambda value: value if isinstance(value, kind) else None


_IMAGE: _Kind = (_text, "the name of an image")
KEYS: dict[str, _Kind] = {
    "format": (_text, "the name of the format"),
    "version": (_number, "the version of the format"),
    "projector_shape": (_shape, "two whole numbers, such as [64, 64]"),
    "camera_shape": (_shape, "two or three whole numbers, such as [480, 640]"),
    "projectors": (_sizes, "rows and columns of each of several, such as [[64, 64], [48, 64]]"),
    "provenance": (_of(dict), "an object; anything may stand in it"),
    "patterns": (_of(list), "the digest of each pattern that was projected"),
    "mask": _IMAGE,
    "black": (_of(dict), "an object with the black frame's file"),
    "exposure": (_several, "a number above 0, or one for each frame"),
    "clip": (_clip, "a level above 0, one for each frame, or auto"),
    "black_level": (_several, "a level of 0 or more, or one for each frame"),
    "full_scale": (_above_0, f"a level above 0, at most {curves.MOST_LEVEL:g}"),
    "response": (_text, curves.RESPONSES),
    "projector_response": (_text, "the name of a projector's curve, or auto"),
    "mosaic": (_of(bool), "true or false"),
}
_BLACK_KEYS: dict[str, _Kind] = {"file": _IMAGE, "exposure": (_above_0, "a number above 0")}
