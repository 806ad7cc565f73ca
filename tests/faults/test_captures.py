"""Capture folders: what capture.json and patterns.json say, and files that are odd, lost or hidden.

tests/capture/test_capture_description.py has all values that a description cannot have.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from .case import Case, Prepare, bear
from .checks import if_accepted, same_matrix, says_not
from .put import DEEP, both, cut, described, json_at, json_edit, link, move, pipe, remove, text

NEEDS = ("capture", "lit", "plain.zarr", "photos", "projected", "black.png", "holiday.jpg")
ESTIMATE = "estimate capture --no-coherent -o new.zarr"
LIT = "estimate lit --no-coherent -o new.zarr"
FOLDERS = "estimate --patterns projected --images photos -o new.zarr"
DESCRIPTION, PATTERNS = "capture/capture.json", "capture/patterns/patterns.json"
PICKLE = (
    b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"
    + b" " * 59
    + b"\ncos\nsystem\n(S'touch pwned'\ntR."
)


def _descriptions() -> list[Case]:
    secret = both(
        text("../secret.txt", "PASSWORD 12345\nroot\n"),
        described(response="curve:../../secret.txt"),
    )
    markup = described(provenance={"camera": "[/red] :smile: [bold"})
    unused = json_edit("lit/capture.json", lambda held: held.pop("black"))
    dangling = link("lit/capture.json", "gone.json")
    pickled = f"{FOLDERS} --response curve:curve.npy"
    return [
        Case("an exposure of 10^400", ESTIMATE, "capture.json", described(exposure=10**400)),
        Case("UTF-16", ESTIMATE, "capture.json", text(DESCRIPTION, "{}".encode("utf-16"))),
        Case("a curve elsewhere", ESTIMATE, "capture.json", secret, check=says_not("PASSWORD")),
        Case("a curve of pickles", pickled, "curve.npy", text("curve.npy", PICKLE)),
        Case("provenance of markup", ESTIMATE, (), markup, code=0),
        Case("black.png that is not named", LIT, "black.png", unused, code=(0, 2)),
        Case("capture.json lost beside a black frame", LIT, "capture.json", dangling),
        Case("a black frame that is a pipe", LIT, "black.png", pipe("lit/black.png")),
    ]


def _patterns() -> list[Case]:
    """patterns.json is believed no more than capture.json."""
    values: dict[str, tuple[Any, ...]] = {
        "kind": ("noise", []),
        "count": (-1, "32", 2**70),
        "shape": ([-8, 8], [10**9, 10**9], "8x8", [8.5, 8]),
        "seed": (-1, 2**64, None),
        "density": (2, float("nan"), "half"),
        "colour": ("red",),
    }
    mix = {"kind": "mix", "shape": [8, 8], "count": 32, "mix": [["a"], 5]}
    faults: dict[str, Prepare] = {
        "nested 100,000 deep": text(PATTERNS, DEEP),
        "null": text(PATTERNS, "null"),
        "a pipe": pipe(PATTERNS),
        "a link that leads nowhere": link(PATTERNS, "gone"),
        "a text for its description": json_at(PATTERNS, "description", value="bernoulli"),
        "a mix of nonsense": json_at(PATTERNS, "description", value=mix),
    }
    return [
        # The images have the last word: they may be used, with a warning.
        *(
            Case(
                f"patterns.json: {key} is {str(value)[:20]}",
                ESTIMATE,
                "patterns.json",
                json_at(PATTERNS, "description", key, value=value),
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


CASES = [*_descriptions(), *_patterns(), *_frames()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_captures(case: Case, work: Path) -> None:
    bear(case, work)
