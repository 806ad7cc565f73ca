"""The options that say where a capture comes from and how it is read, for three commands."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import AUTO, FIND_HELP, described
from lightmatrix.errors import InputError
from lightmatrix.files.reading import read_text

if TYPE_CHECKING:
    from lightmatrix import Capture, ReadSettings
    from lightmatrix.check.finding import Finding

_EACH = "one number; or one per frame, as a,b,c or a text file"


def _reading(*names: str, **settings: Any) -> Any:
    """An option under the heading of how to read photographs."""
    return Option(*names, rich_help_panel="How to read the photographs", **settings)


@dataclass(frozen=True)
class Source:
    """Where a capture comes from: a capture folder, or patterns and photographs with settings."""

    folder: Path | None
    patterns: Path | None
    images: Path | None
    settings: ReadSettings | None
    crop: tuple[tuple[int, int], tuple[int, int]] | None
    # Which responses of a capture folder are to be found in its photographs.
    automatic: frozenset[str] = frozenset()

    def open(self, *, finds_projector: bool = False) -> Capture:
        """The capture, not binned; patterns of unknown light only if `finds_projector`."""
        if self.folder is None:
            assert self.patterns is not None
            assert self.images is not None
            capture = lm.Capture.from_folders(
                self.patterns, self.images, self.settings, crop=self.crop
            )
        else:
            capture = lm.Capture.open(self.folder, crop=self.crop)
            unknown = "projector_response" in self.automatic or capture.projector_unknown
            capture = replace(capture, projector_unknown=unknown)
            if "response" in self.automatic:
                automatic = lm.Response.parse(AUTO)
                capture = replace(capture, decoder=replace(capture.decoder, response=automatic))
        if not finds_projector:
            refuse_unknown_projector(capture)
        return capture

    def check(self) -> list[Finding]:
        """What is wrong with the capture, which may be one that cannot be opened."""
        return lm.check(
            self.folder, patterns=self.patterns, images=self.images, settings=self.settings,
            crop=self.crop,
        )  # fmt: skip


def refuse_unknown_projector(capture: Capture) -> None:
    """Refuse patterns that are grey values whose light is to be found."""
    if capture.projector_unknown:
        raise InputError(
            "a projector's response of auto: only `estimate` finds it, of grey patterns",
            hint="give a file of `lightmatrix response --projector`",
        )


def with_source(*, crop: bool = True) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of a capture in place of its parameter `source`.

    Typer reads the options of a command from its signature. The decorated command therefore gets a
    signature of its own: that of the command, with the parameters of `read_source` in place of
    `source`, and without --crop unless `crop`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        shared = dict(inspect.signature(read_source, eval_str=True).parameters)
        if not crop:
            del shared["crop"]
        own = dict(inspect.signature(command, eval_str=True).parameters)
        del own["source"]
        options = [each.replace(kind=each.KEYWORD_ONLY) for each in (shared | own).values()]

        @functools.wraps(command)
        def run(**values: Any) -> None:
            source = read_source(**{name: values.pop(name) for name in shared})
            command(source=source, **values)

        run.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in options}
        return run

    return decorate


@described(
    capture=Argument(
        metavar="CAPTURE",
        help="A capture folder (patterns/, images/, capture.json); or the patterns.",
    ),
    photographs=Argument(
        metavar="IMAGES", help="The photographs, if the first argument is the patterns."
    ),
    patterns="Pattern images: a folder, or a stack (TIFF, npy, npz).",
    images="Photographs in the same order: a folder, or a stack.",
    black="Photograph under a black pattern, or of ambient light; or a black level.",
    black_exposure=_reading(help="Exposure of the black frame.", show_default="that of the frames"),
    white=_reading(help="Photograph under a white pattern; used as one more sample."),
    mask=_reading(help="Image; pixels at 0 are left out."),
    black_level=_reading(help=f"Raw level without any light: {_EACH}.", show_default="0"),
    clip=_reading(
        help=f"Raw level at which samples clip: {_EACH}; or auto (where samples pile up).",
        show_default="255, 65535, or 1 for float",
    ),
    full_scale=_reading(
        help="Raw level that the response calls 1.", show_default="end of the range"
    ),
    response=Option(help=FIND_HELP, show_default="linear"),
    projector_response=_reading(
        help="Light of the patterns' grey values, from `response --projector`; or auto "
        "(`estimate` finds a gamma, of random grey patterns).",
        show_default="linear",
    ),
    exposure=_reading(
        help=f"Exposure, in any unit: {_EACH}. T is for exposure 1.", show_default="1"
    ),
    crop=_reading(
        metavar="ROW,COL:ROWSxCOLS",
        help="First pixel and size of the rectangle to use, such as 400,600:768x1024.",
        show_default="all",
    ),
    mosaic=_reading(
        "--mosaic",
        help="Raw camera files: one sample for each pixel, without interpolating colours.",
    ),
)
def read_source(
    capture: Path | None = None,
    photographs: Path | None = None,
    patterns: Path | None = None,
    images: Path | None = None,
    black: str | None = None,
    black_exposure: float | None = None,
    white: Path | None = None,
    mask: Path | None = None,
    black_level: str | None = None,
    clip: str | None = None,
    full_scale: float | None = None,
    response: str | None = None,
    projector_response: str | None = None,
    exposure: str | None = None,
    crop: str | None = None,
    mosaic: bool = False,
) -> Source:
    """The source that the options of a command describe."""
    stated: dict[str, Any] = {
        name: value
        for name, value in locals().items()
        if not (value is None or value is False)
        and name not in ("capture", "photographs", "patterns", "images", "crop")
    }
    region = None if crop is None else rectangle(crop)
    if photographs is not None:
        if patterns is not None or images is not None:
            raise InputError(
                f"{capture} and {photographs} were given, and --patterns or --images too",
                hint="give patterns and images once",
            )
        if capture is not None and (capture / "patterns").is_dir():
            hint = f"give {capture} alone, or its patterns and photographs; an output follows -o"
            raise InputError(f"{capture} holds photographs: what is {photographs}?", hint=hint)
        capture, patterns, images = None, capture, photographs
    if capture is not None:
        automatic = {k for k in ("response", "projector_response") if stated.get(k) == AUTO}
        stated = {name: value for name, value in stated.items() if name not in automatic}
        folders = {"patterns": patterns, "images": images}
        besides = [name for name, value in folders.items() if value is not None] + list(stated)
        if besides:
            raise InputError(
                f"a capture folder and {', '.join(map(_option, besides))} were given",
                hint="a capture folder has these settings in capture.json; give one or the other",
            )
        return Source(capture, None, None, None, region, frozenset(automatic))
    if patterns is None and images is None:
        hint = "give a capture folder, or --patterns and --images"
        raise InputError("no capture is given", hint=hint)
    if patterns is None or images is None:
        missing = "--patterns" if patterns is None else "--images"
        raise InputError(f"{missing} is missing", hint="give both, or a capture folder")
    # Some texts hold numbers.
    for name in ("exposure", "clip", "black_level"):
        if name in stated and not (name == "clip" and stated[name] == AUTO):
            stated[name] = numbers(stated[name], _option(name))
    if "black" in stated:
        stated["black"] = level_or_file(stated["black"])
    return Source(None, patterns, images, lm.ReadSettings(**stated), region)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def rectangle(text: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Corner and shape of a rectangle of photographs, written as 400,600:768x1024."""
    match = re.fullmatch(r" *([0-9]+) *, *([0-9]+) *: *([0-9]+) *[xX*] *([0-9]+) *", text)
    if match is None or max(map(len, match.groups())) > 9:
        hint = "write row and column of its first pixel, then rows x columns: 400,600:768x1024"
        raise InputError(f"--crop {text!r}", hint=hint)
    row, col, rows, cols = map(int, match.groups())
    return (row, col), (rows, cols)


def level_or_file(text: str) -> float | str:
    """A black level, or the name of a file."""
    if text.isascii() and text.replace(".", "", 1).isdecimal():
        return float(text)
    return text


def numbers(text: str, option: str) -> float | list[float]:
    """One number, or one for each frame, in the text itself or in the file that it names."""
    wrong = InputError(
        f"{option} {text!r}",
        hint="give one number, or one for each frame: 1,0.5,0.25 or a text file of them",
    )
    # Unlike pathlib, os.path accepts lists that are too long for a file name.
    content = read_text(text) if os.path.isfile(text) else text
    try:
        values = [float(word) for word in content.replace(",", " ").replace(";", " ").split()]
    except ValueError:
        raise wrong from None
    if not values:
        raise wrong
    return values if len(values) > 1 else values[0]
