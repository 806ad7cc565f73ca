"""D2 to D4: a capture folder whose files are odd, lost or hidden."""

from __future__ import annotations

from typing import Any

from ..case import Case
from ..checks import every, if_accepted, near_matrix, same_matrix, says_not, within
from ..put import (
    DEEP,
    both,
    copy,
    cut,
    json_at,
    json_edit,
    link,
    move,
    pipe,
    remove,
    text,
)

ESTIMATE = "estimate capture --no-coherent -o new.zarr"
LIT = "estimate lit --no-coherent -o new.zarr"


def _curves() -> list[Case]:
    """Response curves that are none, or none to believe."""
    line = "estimate --patterns projected --images photos -o new.zarr --response curve:"
    return [
        Case(
            "a curve that is another text",
            f"{line}notes.txt",
            "notes.txt",
            text("notes.txt", "PASSWORD 12345\n"),
            check=says_not("PASSWORD"),
        ),
        Case(
            "a curve that is empty",
            f"{line}curve.txt",
            "curve.txt",
            text("curve.txt", ""),
            check=says_not("finished tiles"),
        ),
        Case("a curve of one point", f"{line}curve.txt", "curve.txt", text("curve.txt", "1 1\n")),
        Case(
            "a curve that goes down",
            f"{line}curve.txt",
            "curve.txt|curve",
            text("curve.txt", "0 1\n128 0.5\n255 0\n"),
        ),
        Case(
            "a curve with nan",
            f"{line}curve.txt",
            "curve.txt|curve",
            text("curve.txt", "0 0\n128 nan\n255 1\n"),
        ),
        Case(
            "a curve with infinity",
            f"{line}curve.txt",
            "curve.txt|curve",
            text("curve.txt", "0 0\n128 1\n255 inf\n"),
        ),
        Case(
            "a curve of 1e308",
            f"{line}curve.txt",
            "curve.txt|curve",
            text("curve.txt", "0 -1e308\n128 1\n255 1e308\n"),
        ),
        Case(
            "a curve of three columns",
            f"{line}curve.txt",
            "curve.txt",
            text("curve.txt", "0 0 0\n1 1 1\n"),
        ),
        Case(
            "a curve of noise",
            f"{line}curve.npy",
            "curve.npy",
            text("curve.npy", bytes(range(256)) * 9),
        ),
        Case("a curve that is a pipe", f"{line}curve.txt", "curve.txt", pipe("curve.txt")),
        Case(
            "a curve of pickles",
            f"{line}curve.npy",
            "curve.npy",
            text(
                "curve.npy",
                b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"
                + b" " * 59
                + b"\ncos\nsystem\n(S'touch pwned'\ntR.",
            ),
        ),
    ]


def _black() -> list[Case]:
    """A black frame must be used, or the message must say that it is not."""
    lone = both(copy("lit", "bare"), remove("bare/capture.json"))
    command = "estimate bare --no-coherent -o new.zarr"
    # Either it is refused with its name, or the estimate is that with the black frame.
    used = if_accepted(same_matrix("new.zarr", "wanted.zarr"))

    def also_wanted(folder: Any) -> None:
        from ..zygote import run_command

        lone(folder)
        line = "estimate --patterns bare/patterns --images bare/images --black bare/black.png"
        run_command(f"{line} --no-coherent -o wanted.zarr", folder)

    return [
        Case(
            "black.png without a capture.json",
            command,
            "black.png|",
            also_wanted,
            code=(0, 2),
            check=used,
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
            "estimate lit --no-coherent -o new.zarr",
            "capture.json",
            link("lit/capture.json", "gone.json"),
        ),
        Case(
            "a black frame of another depth",
            LIT,
            "black.png",
            copy("capture/images/image_0000.png", "lit/black.png"),
            code=2,
        ),
        Case("a black frame that is a pipe", LIT, "black.png", pipe("lit/black.png")),
    ]


def _patterns() -> list[Case]:
    """patterns.json is believed no more than capture.json."""
    header = "capture/patterns/patterns.json"
    values: dict[str, tuple[Any, ...]] = {
        "kind": ("noise", None, 5, []),
        "count": (-1, 0, "32", 2**70, None, 1e300, [32]),
        "shape": ([0, 8], [-8, 8], [10**9, 10**9], "8x8", 64, [8], [8, 8, 8], [8.5, 8], None),
        "seed": (-1, "0", 2**64, 1.5, None, []),
        "density": (2, float("nan"), "half", None, -1),
        "colour": ("red",),
    }
    cases = []
    for key, wrong in values.items():
        for number, value in enumerate(wrong):
            # The images have the last word: they may be used, with a warning.
            cases.append(
                Case(
                    f"patterns.json: {key} is {str(value)[:20]} ({number})",
                    ESTIMATE,
                    "patterns.json",
                    json_at(header, "description", key, value=value),
                    code=(0, 2),
                    check=every(within(10), if_accepted(near_matrix("new.zarr", "plain.zarr"))),
                )
            )
    whole: dict[str, str] = {
        "nested 100,000 deep": DEEP,
        "a list": "[]",
        "empty": "",
        "null": "null",
    }
    cases += [
        Case(f"patterns.json: {what}", ESTIMATE, "patterns.json", text(header, content))
        for what, content in whole.items()
    ]
    return [
        *cases,
        Case("patterns.json: a pipe", ESTIMATE, "patterns.json", pipe(header)),
        Case(
            "patterns.json: a link that leads nowhere",
            ESTIMATE,
            "patterns.json",
            link(header, "gone"),
        ),
        Case(
            "patterns.json: a text for its description",
            ESTIMATE,
            "patterns.json",
            json_at(header, "description", value="bernoulli"),
        ),
        Case(
            "a mix of nonsense",
            ESTIMATE,
            "patterns.json",
            json_at(
                header,
                "description",
                value={"kind": "mix", "shape": [8, 8], "count": 32, "mix": [["a"], 5]},
            ),
        ),
    ]


def _frames() -> list[Case]:
    first = "capture/images/image_0000.png"
    return [
        Case(
            "an image called ²1.png",
            ESTIMATE,
            (),
            move(first, "capture/images/²1.png"),
            code=(0, 2),
        ),
        Case(
            "an image called ٣.png", ESTIMATE, (), move(first, "capture/images/٣.png"), code=(0, 2)
        ),
        Case(
            "an image with a number of 10,000 digits",
            "estimate --patterns projected --images photos -o new.zarr",
            (),
            move("photos/image_0000.png", "photos/" + "0" * 240 + ".png"),
            code=0,
        ),
        Case(
            "an image with a huge number",
            ESTIMATE,
            (),
            move("capture/images/image_0031.png", "capture/images/image_" + "9" * 200 + ".png"),
            code=0,
        ),
        Case(
            "a broken image called [b].png",
            ESTIMATE,
            "[b].png",
            both(move(first, "capture/images/[b].png"), cut("capture/images/[b].png", 60)),
        ),
        Case("an image that is a pipe", ESTIMATE, "image_0000.png|31 images", pipe(first)),
        Case(
            "an image that is a link to nowhere",
            ESTIMATE,
            "image_0000.png|31 images",
            link(first, "gone.png"),
        ),
        Case(
            "images/ that is a link to itself", ESTIMATE, "images", link("capture/images", "images")
        ),
        Case(
            "images/ that is a file",
            ESTIMATE,
            "images",
            both(remove("capture/images"), text("capture/images")),
        ),
        Case("no patterns/", ESTIMATE, "patterns", remove("capture/patterns")),
        Case("a capture that is a pipe", "estimate in -o new.zarr", "in", pipe("in")),
        Case("a capture that is a store", "estimate plain.zarr -o new.zarr", "plain.zarr"),
        Case("info of photographs alone", "info photos", "photos"),
        Case("a lost last frame", ESTIMATE, "31 images", remove("capture/images/image_0031.png")),
    ]


# What its cases need of the work folder.
NEEDS = ("capture", "lit", "plain.zarr", "photos", "projected", "black.png", "holiday.jpg")

CASES = [*_curves(), *_black(), *_patterns(), *_frames()]
