"""D2 to D4: a capture.json that says odd things, leads elsewhere, or is none."""

from __future__ import annotations

from typing import Any

from ..case import Case
from ..checks import every, near_matrix, says_not
from ..put import (
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

ESTIMATE = "estimate capture --no-coherent -o new.zarr"
LIT = "estimate lit --no-coherent -o new.zarr"
HEADER = "capture/capture.json"
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
    cases = []
    for key, values in VALUES.items():
        for number, value in enumerate(values):
            shown = str(value)[:24]
            cases.append(
                Case(
                    f"capture.json: {key} is {shown} ({number})",
                    ESTIMATE,
                    f"capture.json|capture/|{key.replace('_', ' ')}",
                    described(**{key: value}),
                )
            )
    for number, value in enumerate((float("nan"), float("inf"), -float("inf"))):
        for key in ("exposure", "clip", "black_level", "full_scale"):
            cases.append(
                Case(
                    f"capture.json: {key} is {value} ({number})",
                    ESTIMATE,
                    f"capture.json|capture/|{key.replace('_', ' ')}",
                    described(**{key: value}),
                )
            )
    for extra in BLACK:
        # NaN is no JSON, so the parser names the file but not the key.
        unknown = any(isinstance(value, float) and value != 0.8 for value in extra.values())

        def edit(held: dict[str, Any], extra: dict[str, Any] = extra) -> None:
            held["black"] = {**held["black"], **extra}

        cases.append(
            Case(
                f"capture.json: black with {extra}",
                LIT,
                "lit/capture.json" if unknown else "black",
                json_edit("lit/capture.json", edit),
            )
        )
    return cases


def _file() -> list[Case]:
    contents: dict[str, str | bytes] = {
        "nested 100,000 deep": DEEP,
        "nested deep below a key": '{"format": "lightmatrix-capture", "version": 1, "mask": '
        + DEEP
        + "}",
        "a list": "[1]",
        "a number": "5",
        "null": "null",
        "empty": "",
        "blank": "  \n",
        "not JSON": "{exposure: 0.5}",
        "cut off": '{"format": "lightmatrix-capture", "ver',
        "UTF-16": '{"format": "lightmatrix-capture", "version": 1}'.encode("utf-16"),
        "not UTF-8": b'{"format": "lightmatrix-capture", "version": 1, "mask": "caf\xe9"}',
        "zeros": bytes(500),
        "a number of 10,000 digits": '{"format": "lightmatrix-capture", "version": 1, "clip": '
        + "9" * 10_000
        + "}",
        "a key twice": '{"format": "lightmatrix-capture", "version": 1, "clip": 99, "clip": 9}',
    }
    cases = [
        Case(f"capture.json: {what}", ESTIMATE, "capture.json", text(HEADER, content))
        for what, content in contents.items()
    ]
    return [
        *cases,
        Case("capture.json: a folder", ESTIMATE, "capture.json", folder_at(HEADER)),
        Case("capture.json: a pipe", ESTIMATE, "capture.json", pipe(HEADER)),
        Case(
            "capture.json: a link that leads nowhere",
            ESTIMATE,
            "capture.json",
            link(HEADER, "gone.json"),
        ),
        Case(
            "capture.json: a link to itself", ESTIMATE, "capture.json", link(HEADER, "capture.json")
        ),
        Case(
            "capture.json called Capture.json",
            ESTIMATE,
            "Capture.json",
            move(HEADER, "capture/Capture.json"),
        ),
        Case(
            "capture.json with provenance of markup",
            ESTIMATE,
            (),
            described(provenance={"camera": "[/red] :smile: [bold"}),
            code=0,
        ),
        Case("capture.json with provenance null", ESTIMATE, (), described(provenance=None), code=0),
        Case(
            # Some editors leave one; the text behind it is what was meant.
            "capture.json with a byte order mark",
            ESTIMATE,
            (),
            lambda folder: (folder / HEADER).write_bytes(
                b"\xef\xbb\xbf" + (folder / HEADER).read_bytes()
            ),
            code=0,
            check=near_matrix("new.zarr", "plain.zarr"),
        ),
    ]


def _paths() -> list[Case]:
    """Files that capture.json names must lie in its folder."""
    secret = text("../secret.txt", "PASSWORD 12345\nroot\n")
    cases = []
    for way in ("../outside.png", "{absolute}", "images/../../outside.png", "~/outside.png"):
        for key in ("black", "mask"):

            def fault(folder: Any, way: str = way, key: str = key) -> None:
                copy("black.png", "outside.png")(folder)
                name = way.replace("{absolute}", str(folder / "outside.png"))
                value = {"file": name, "exposure": 0.8} if key == "black" else name
                json_at("lit/capture.json", key, value=value)(folder)

            cases.append(
                Case(f"capture.json: {key} is {way}", LIT, "capture.json|outside.png", fault)
            )
    for way in ("../../secret.txt", "../holiday.jpg"):
        cases.append(
            Case(
                f"capture.json: a curve at {way}",
                ESTIMATE,
                "capture.json|secret.txt|holiday.jpg",
                both(secret, described(response=f"curve:{way}")),
                check=every(says_not("PASSWORD"), says_not("dear to its owner")),
            )
        )
    return cases


# What its cases need of the work folder.
NEEDS = ("capture", "lit", "plain.zarr", "photos", "projected", "black.png", "holiday.jpg")

CASES = [*_values(), *_file(), *_paths()]
