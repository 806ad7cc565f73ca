"""A capture.json that says odd things, leads elsewhere, or is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from .case import Case, Prepare, bear
from .checks import same_matrix, says_not
from .put import (
    DEEP,
    both,
    copy,
    described,
    folder_at,
    json_at,
    json_edit,
    link,
    move,
    pipe,
    text,
)

NEEDS = ("capture", "lit", "plain.zarr", "photos", "projected", "black.png", "holiday.jpg")
ESTIMATE = "estimate capture --no-coherent -o new.zarr"
LIT = "estimate lit --no-coherent -o new.zarr"
HEADER = "capture/capture.json"
START = '{"format": "lightmatrix-capture", "version": 1'
MANY = 10**400  # JSON knows such numbers

# Key of capture.json -> values that it cannot have.
VALUES: dict[str, tuple[Any, ...]] = {
    "exposure": (0, -1, "a", "0.8", None, [], [1, 2], [1] * 31, [[1] * 32], True, {"a": 1}, MANY),
    "clip": ("x", -1, 0, [], {}, 1e300, 300, [255] * 5, True),
    "black_level": ("2", -1e300, 1e300, 255, 300, [], {}, [0] * 5, True),
    "full_scale": (1e300, 0, -1, "255", [], {}, True),
    "response": (5, {}, [], "film", "gamma:0", True),
    "mask": (5, {}, [], "nowhere.png", "", ".", True),
    "black": ("black.png", [], {}, {"file": 5}, {"file": "nowhere.png"}, {"file": None}, 7, True),
    "camera_shape": ("8x8", [8], [8, 9], None, [[8], [8]], 64, [8.5, 8]),
    "projector_shape": ([8, 9], {}, "8x8"),
    "version": (0, 2, "1", None, [1], 1e300),
    "format": (5, "lightmatrix-patterns", None, []),
    "provenance": ("text", ["a"], 5, True),
}
# Parts of the black frame's own entry; lit/ has one.
BLACK: tuple[dict[str, Any], ...] = (
    {"exposure": -1},
    {"exposure": 0},
    {"exposure": "0.8"},
    {"exposure": []},
    {"exposure": [0.8] * 32},
    {"exposure": float("nan")},
    {"exposure": float("inf")},
    {"exposures": 0.8},
    {"expsure": 0.8},
    {"File": "black.png"},
    {"level": 2},
)


def _values() -> list[Case]:
    odd = {key: (float("nan"), float("inf")) for key in ("exposure", "clip", "full_scale")}
    return [
        *(
            Case(
                f"{key} is {str(value)[:24]}",
                ESTIMATE,
                f"capture.json|capture/|{key.replace('_', ' ')}",
                described(**{key: value}),
            )
            for table in (VALUES, odd)
            for key, values in table.items()
            for value in values
        ),
        *(
            Case(
                f"black with {extra}",
                LIT,
                # NaN is no JSON, so the parser names the file but not the key.
                "lit/capture.json" if str(extra.get("exposure")) in ("nan", "inf") else "black",
                json_edit("lit/capture.json", lambda held, e=extra: held["black"].update(e)),  # type: ignore[misc]
            )
            for extra in BLACK
        ),
    ]


def _file() -> list[Case]:
    contents: dict[str, str | bytes] = {
        "nested 100,000 deep": DEEP,
        "nested deep below a key": f'{START}, "mask": {DEEP}}}',
        "a list": "[1]",
        "a number": "5",
        "null": "null",
        "empty": "",
        "blank": "  \n",
        "not JSON": "{exposure: 0.5}",
        "cut off": START[:-4],
        "UTF-16": f"{START}}}".encode("utf-16"),
        "not UTF-8": START.encode() + b', "mask": "caf\xe9"}',
        "zeros": bytes(500),
        "a number of 10,000 digits": f'{START}, "clip": {"9" * 10_000}}}',
        "a key twice": f'{START}, "clip": 99, "clip": 9}}',
    }
    faults: dict[str, Prepare] = {
        **{words: text(HEADER, content) for words, content in contents.items()},
        "a folder": folder_at(HEADER),
        "a pipe": pipe(HEADER),
        "a link that leads nowhere": link(HEADER, "gone.json"),
        "a link to itself": link(HEADER, "capture.json"),
        "called Capture.json": move(HEADER, "capture/Capture.json"),
    }

    def with_mark(folder: Path) -> None:
        # Some editors leave a byte order mark; the text behind it is what was meant.
        (folder / HEADER).write_bytes(b"\xef\xbb\xbf" + (folder / HEADER).read_bytes())

    markup = described(provenance={"camera": "[/red] :smile: [bold"})
    same = same_matrix("new.zarr", "plain.zarr", 1e-3)
    return [
        *(Case(f"capture.json: {w}", ESTIMATE, "capture.json", put) for w, put in faults.items()),
        Case("provenance of markup", ESTIMATE, (), markup, code=0),
        Case("provenance null", ESTIMATE, (), described(provenance=None), code=0),
        Case("a byte order mark", ESTIMATE, (), with_mark, code=0, check=same),
    ]


def _paths() -> list[Case]:
    """Files that capture.json names must lie in its folder."""
    cases = []
    for way in ("../outside.png", "{absolute}", "images/../../outside.png", "~/outside.png"):
        for key in ("black", "mask"):

            def fault(folder: Path, way: str = way, key: str = key) -> None:
                copy("black.png", "outside.png")(folder)
                name = way.replace("{absolute}", str(folder / "outside.png"))
                value = {"file": name, "exposure": 0.8} if key == "black" else name
                json_at("lit/capture.json", key, value=value)(folder)

            cases.append(Case(f"{key} is {way}", LIT, "capture.json|outside.png", fault))
    secret = text("../secret.txt", "PASSWORD 12345\nroot\n")
    for way in ("../../secret.txt", "../holiday.jpg"):
        put = both(secret, described(response=f"curve:{way}"))
        quiet = says_not("PASSWORD", "dear to its owner")
        says = "capture.json|secret.txt|holiday.jpg"
        cases.append(Case(f"a curve at {way}", ESTIMATE, says, put, check=quiet))
    return cases


CASES = [*_values(), *_file(), *_paths()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_descriptions(case: Case, work: Path) -> None:
    bear(case, work)
