"""Where a capture comes from: a folder that says all of it, or patterns, images and options."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from lightmatrix.errors import InputError
from lightmatrix.files.reading import read_text

_EACH = "one number, numbers a,b,c or a text file of one for each frame"

Folder = Annotated[
    Path | None,
    typer.Argument(
        metavar="CAPTURE",
        help="Capture folder (patterns/, images/, capture.json); or the patterns, see --patterns.",
    ),
]
Photographs = Annotated[
    Path | None,
    typer.Argument(metavar="IMAGES", help="The photographs, if the patterns came before."),
]
Patterns = Annotated[
    Path | None,
    typer.Option("--patterns", help="Pattern images: a folder, or a stack (TIFF, npy, npz)."),
]
Images = Annotated[
    Path | None,
    typer.Option("--images", help="Photographs in the same order: a folder, or a stack."),
]
Black = Annotated[
    str | None,
    typer.Option(
        "--black", help="Photograph under a black pattern, or of ambient light; or a black level."
    ),
]
BlackExposure = Annotated[
    float | None,
    typer.Option(help="Exposure of the black frame.", show_default="that of the frames"),
]
White = Annotated[
    Path | None,
    typer.Option("--white", help="Photograph under a white pattern; one more sample."),
]
Mask = Annotated[Path | None, typer.Option("--mask", help="Image; pixels at 0 are left out.")]
BlackLevel = Annotated[
    str | None,
    typer.Option(help=f"Raw level without any light: {_EACH}.", show_default="0"),
]
ClipLevel = Annotated[
    str | None,
    typer.Option(
        "--clip",
        help=f"Raw level at which samples clip: {_EACH}.",
        show_default="255, 65535, or 1 for float",
    ),
]
FullScale = Annotated[
    float | None,
    typer.Option(help="Raw level that the response calls 1.", show_default="end of the range"),
]
Exposure = Annotated[
    str | None,
    typer.Option(
        "--exposure",
        help=f"Exposure, in any unit: {_EACH}. T is for exposure 1.",
        show_default="1",
    ),
]

Crop = Annotated[
    str | None,
    typer.Option(
        "--crop",
        metavar="ROW,COL:ROWSxCOLS",
        help="Rectangle of the photographs to use, from its first pixel, such as 400,600:768x1024.",
        show_default="all",
    ),
]


ProjectorCurve = Annotated[
    Path | None,
    typer.Option(
        "--projector-response",
        help="Light of the patterns' grey values, from `response --projector`.",
        show_default="linear",
    ),
]


Mosaic = Annotated[
    bool,
    typer.Option(
        "--mosaic", help="Raw camera files: each pixel a sample, not interpolated to colours."
    ),
]


def source(
    capture: Path | None,
    photographs: Path | None,
    patterns: Path | None,
    images: Path | None,
    *,
    crop: str | None = None,
    **options: object,
) -> dict[str, Any]:
    """What a function of the door is told of where a capture comes from.

    Parameters
    ----------
    capture, photographs : Path, optional
        The first and the second place that were given without an option.
    patterns, images : Path, optional
        As given.
    crop : str, optional
        A rectangle of the photographs, wherever they come from.
    options : optional
        The others, by their names in Python; None where nothing was said.

    Returns
    -------
    dict
        Either ``capture``, or ``patterns``, ``images`` and what else was said; and ``crop``.

    Raises
    ------
    InputError
        Unless there is a capture folder alone, or patterns and images.
    """
    cut = {} if crop is None else {"crop": rectangle(crop)}
    if photographs is not None:
        if patterns is not None or images is not None:
            raise InputError(
                f"{capture} and {photographs}, and --patterns or --images besides, were given",
                hint="give patterns and images once",
            )
        capture, patterns, images = None, capture, photographs
    said = {name: value for name, value in options.items() if value is not None}
    if capture is not None:
        plain = {"patterns": patterns, "images": images, **said}
        given = [
            f"--{name.replace('_', '-')}" for name, value in plain.items() if value is not None
        ]
        if given:
            raise InputError(
                f"a capture folder and {', '.join(given)} were given",
                hint="a capture folder says all that in capture.json; give one or the other",
            )
        return {"capture": capture, **cut}
    if patterns is None and images is None:
        raise InputError(
            "there is nothing to look at or to estimate from",
            hint="give a capture folder, or --patterns and --images",
        )
    if patterns is None or images is None:
        missing = "--patterns" if patterns is None else "--images"
        raise InputError(f"{missing} is missing", hint="give both, or a capture folder")
    return {"patterns": patterns, "images": images, **cut, **_read(said)}


def _read(said: Mapping[str, Any]) -> dict[str, Any]:
    """The options with numbers in place of text."""
    read = dict(said)
    for name in ("exposure", "clip", "black_level"):
        if name in read:
            read[name] = numbers(read[name], f"--{name.replace('_', '-')}")
    if "black" in read:
        read["black"] = level_or_file(read["black"])
    return read


def rectangle(text: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Corner and shape of a rectangle of photographs, such as 400,600:768x1024.

    Raises
    ------
    InputError
        On anything else.
    """
    found = re.fullmatch(r" *([0-9]+) *, *([0-9]+) *: *([0-9]+) *[xX*] *([0-9]+) *", text)
    if found is None or max(map(len, found.groups())) > 9:
        raise InputError(
            f"--crop {text!r}",
            hint="write row and column of its first pixel, then rows x columns: 400,600:768x1024",
        )
    row, col, rows, cols = map(int, found.groups())
    return (row, col), (rows, cols)


def level_or_file(text: str) -> float | str:
    """A black level, or the name of a file."""
    if text.isascii() and text.replace(".", "", 1).isdecimal():
        return float(text)
    return text


def numbers(text: str, option: str) -> float | list[float]:
    """One number; or one for each frame, separated by commas, or by anything in a text file.

    Raises
    ------
    InputError
        Naming the option, on anything else.
    """
    wrong = InputError(
        f"{option} {text!r}",
        hint="give one number, or one for each frame: 1,0.5,0.25 or a text file of them",
    )
    # Not of pathlib, which stumbles over lists that are too long for a name.
    listed = read_text(text) if os.path.isfile(text) else text
    try:
        values = [float(word) for word in listed.replace(",", " ").replace(";", " ").split()]
    except ValueError:
        raise wrong from None
    if not values:
        raise wrong
    return values if len(values) > 1 else values[0]
