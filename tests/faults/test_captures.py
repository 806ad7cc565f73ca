"""A capture folder whose files are odd, lost or hidden."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from .case import Case, Prepare, bear
from .checks import if_accepted, same_matrix, says_not
from .put import DEEP, both, copy, cut, json_at, json_edit, link, move, pipe, remove, text
from .run import run

NEEDS = ("capture", "lit", "plain.zarr", "photos", "projected", "black.png", "holiday.jpg")
ESTIMATE = "estimate capture --no-coherent -o new.zarr"
LIT = "estimate lit --no-coherent -o new.zarr"
FOLDERS = "estimate --patterns projected --images photos -o new.zarr"
HEADER = "capture/patterns/patterns.json"
PICKLE = (
    b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"
    + b" " * 59
    + b"\ncos\nsystem\n(S'touch pwned'\ntR."
)


def _curves() -> list[Case]:
    """Response curves that are none, or none to believe."""
    contents: dict[str, tuple[str, str | bytes]] = {
        "that is another text": ("curve.txt", "PASSWORD 12345\n"),
        "that is empty": ("curve.txt", ""),
        "of one point": ("curve.txt", "1 1\n"),
        "that goes down": ("curve.txt", "0 1\n128 0.5\n255 0\n"),
        "with nan": ("curve.txt", "0 0\n128 nan\n255 1\n"),
        "with infinity": ("curve.txt", "0 0\n128 1\n255 inf\n"),
        "of 1e308": ("curve.txt", "0 -1e308\n128 1\n255 1e308\n"),
        "of three columns": ("curve.txt", "0 0 0\n1 1 1\n"),
        "of noise": ("curve.npy", bytes(range(256)) * 9),
        "of pickles": ("curve.npy", PICKLE),
    }
    line = f"{FOLDERS} --response curve:"
    return [
        *(
            Case(
                f"a curve {words}",
                f"{line}{name}",
                f"{name}|curve",
                text(name, content),
                check=says_not("PASSWORD", "finished tiles"),
            )
            for words, (name, content) in contents.items()
        ),
        Case("a curve that is a pipe", f"{line}curve.txt", "curve.txt", pipe("curve.txt")),
    ]


def _black() -> list[Case]:
    """A black frame must be used, or the message must say that it is not."""

    def bare(folder: Path) -> None:
        both(copy("lit", "bare"), remove("bare/capture.json"))(folder)
        frames = "--patterns bare/patterns --images bare/images --black bare/black.png"
        run(f"estimate {frames} --no-coherent -o wanted.zarr", folder)

    return [
        # Either it is refused with its name, or the estimate is that with the black frame.
        Case(
            "black.png without a capture.json",
            "estimate bare --no-coherent -o new.zarr",
            "black.png|",
            bare,
            code=(0, 2),
            check=if_accepted(same_matrix("new.zarr", "wanted.zarr")),
        ),
        Case(
            "black.png that capture.json does not name",
            LIT,
            "black.png",
            json_edit("lit/capture.json", lambda held: held.pop("black")),
            code=(0, 2),
        ),
        Case(
            "capture.json lost to a dangling link, with a black frame",
            LIT,
            "capture.json",
            link("lit/capture.json", "gone.json"),
        ),
        Case(
            "a black frame of another depth",
            LIT,
            "black.png",
            copy("capture/images/image_0000.png", "lit/black.png"),
        ),
        Case("a black frame that is a pipe", LIT, "black.png", pipe("lit/black.png")),
    ]


def _patterns() -> list[Case]:
    """patterns.json is believed no more than capture.json."""
    values: dict[str, tuple[Any, ...]] = {
        "kind": ("noise", None, 5, []),
        "count": (-1, 0, "32", 2**70, None, 1e300, [32]),
        "shape": ([0, 8], [-8, 8], [10**9, 10**9], "8x8", 64, [8], [8, 8, 8], [8.5, 8], None),
        "seed": (-1, "0", 2**64, 1.5, None, []),
        "density": (2, float("nan"), "half", None, -1),
        "colour": ("red",),
    }
    mix = {"kind": "mix", "shape": [8, 8], "count": 32, "mix": [["a"], 5]}
    faults: dict[str, Prepare] = {
        "nested 100,000 deep": text(HEADER, DEEP),
        "a list": text(HEADER, "[]"),
        "empty": text(HEADER, ""),
        "null": text(HEADER, "null"),
        "a pipe": pipe(HEADER),
        "a link that leads nowhere": link(HEADER, "gone"),
        "a text for its description": json_at(HEADER, "description", value="bernoulli"),
        "a mix of nonsense": json_at(HEADER, "description", value=mix),
    }
    return [
        # The images have the last word: they may be used, with a warning.
        *(
            Case(
                f"patterns.json: {key} is {str(value)[:20]}",
                ESTIMATE,
                "patterns.json",
                json_at(HEADER, "description", key, value=value),
                code=(0, 2),
                check=if_accepted(same_matrix("new.zarr", "plain.zarr", 1e-3)),
            )
            for key, wrong in values.items()
            for value in wrong
        ),
        *(Case(f"patterns.json: {w}", ESTIMATE, "patterns.json", put) for w, put in faults.items()),
    ]


def _frames() -> list[Case]:
    images = "capture/images"
    first, last = f"{images}/image_0000.png", f"{images}/image_0031.png"
    broken = both(move(first, f"{images}/[b].png"), cut(f"{images}/[b].png", 60))
    many_digits = move("photos/image_0000.png", "photos/" + "0" * 240 + ".png")
    huge = move(last, f"{images}/image_{'9' * 200}.png")
    lost = "image_0000.png|31 images"
    no_folder = both(remove(images), text(images))
    return [
        *(
            Case(f"an image called {n}", ESTIMATE, (), move(first, f"{images}/{n}"), code=(0, 2))
            for n in ("²1.png", "٣.png")
        ),
        Case("an image with a number of 240 digits", FOLDERS, (), many_digits, code=0),
        Case("an image with a huge number", ESTIMATE, (), huge, code=0),
        Case("a broken image called [b].png", ESTIMATE, "[b].png", broken),
        Case("an image that is a pipe", ESTIMATE, lost, pipe(first)),
        Case("an image that is a link to nowhere", ESTIMATE, lost, link(first, "gone.png")),
        Case("images/ that is a link to itself", ESTIMATE, "images", link(images, "images")),
        Case("images/ that is a file", ESTIMATE, "images", no_folder),
        Case("no patterns/", ESTIMATE, "patterns", remove("capture/patterns")),
        Case("a capture that is a pipe", "estimate in -o new.zarr", "in", pipe("in")),
        Case("a capture that is a store", "estimate plain.zarr -o new.zarr", "plain.zarr"),
        Case("info of photographs alone", "info photos", "photos"),
        Case("a lost last frame", ESTIMATE, "31 images", remove(last)),
    ]


CASES = [*_curves(), *_black(), *_patterns(), *_frames()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_captures(case: Case, work: Path) -> None:
    bear(case, work)
