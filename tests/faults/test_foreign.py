"""What others have put where an output is to go, or beside it."""

from __future__ import annotations

from pathlib import Path

import pytest

from .case import Case, Prepare, bear
from .put import both, copy, folder_at, link, text
from .test_outputs import ESTIMATE, PATTERNS, SIMULATE

NEEDS = ("T.npz", "patterns", "capture", "scene.zarr", "plain.zarr", "photos", "projected")
# Files of ours; their names alone must not make a folder one of ours.
NAMES = ("capture.json", "patterns.json", "zarr.json", "scenes.json", "demo.json", "fig4.json")
HAND_WRITTEN = '{"format": "lightmatrix-capture", "version": 1, "exposure": 0.5}\n'
ZARR = '{"zarr_format": 3, "node_type": "group"'
PARTIAL = "o.zarr.partial"


def _folders() -> list[Case]:
    cases = [
        Case(
            f"a folder of photographs with a {name}: {content[:2]}",
            f"{PATTERNS} -o mine --overwrite",
            "mine",
            both(text(f"mine/{name}", content), text("mine/photo.jpg")),
        )
        for name in NAMES
        for content in (HAND_WRITTEN, "{}", "")
    ]
    ours = {"patterns": PATTERNS, "capture": SIMULATE, "scene.zarr": ESTIMATE}
    for folder, command in ours.items():
        # The capture is estimated from, so outputs go to a copy.
        old = f"old{Path(folder).suffix}"
        line, kept = f"{command} -o {old} --overwrite", ("exists", "--overwrite")
        cases += [
            *(
                Case(
                    f"{folder} with one foreign file {addition}",
                    line,
                    "old",
                    both(copy(folder, old), text(f"{old}/{addition}")),
                )
                for addition in ("holiday.jpg", ".notes", "more/raw.dng", "images/image_9999.png")
            ),
            Case(f"{folder} of ours is replaced", line, (), copy(folder, old), code=0),
            Case(f"{folder} of ours is kept without --overwrite", f"{command} -o {folder}", kept),
        ]
    by_hand = both(copy("photos", "cap/images"), text("cap/capture.json", HAND_WRITTEN))
    whole = both(by_hand, copy("projected", "cap/patterns"))
    store = f"{ESTIMATE} -o other.zarr --overwrite"
    named = ZARR + ', "attributes": {"format": "ome"}}'
    return [
        *cases,
        Case("photographs, described by hand", f"{PATTERNS} -o cap --overwrite", "cap", by_hand),
        Case("a whole hand-made capture", f"{SIMULATE} -o cap --overwrite", "cap", whole),
        Case("photographs alone", f"{PATTERNS} -o photos --overwrite", "photos"),
        Case("another store", store, "other.zarr", text("other.zarr/zarr.json", ZARR + "}")),
        Case("a store of a format", store, "other.zarr", text("other.zarr/zarr.json", named)),
        Case("an empty folder is filled", f"{PATTERNS} -o new", (), folder_at("new"), code=0),
    ]


def _siblings() -> list[Case]:
    line = f"{ESTIMATE} -o o.zarr"
    photo = text(f"{PARTIAL}/photo.jpg")
    tile = both(text(f"{PARTIAL}/rows-0-9.npz"), text(f"{PARTIAL}/fingerprint.json", "{}"))
    foreign: dict[str, tuple[str, Prepare]] = {
        "a folder": (line, photo),
        "a folder, and --overwrite": (f"{line} --overwrite", photo),
        "an npz, and --overwrite": (f"{line} --overwrite", tile),
        "a file": (line, text(PARTIAL)),
        "a link to photographs": (line, link(PARTIAL, "photos")),
    }
    return [
        *(Case(f"{w} at {PARTIAL}", line, PARTIAL, put) for w, (line, put) in foreign.items()),
        Case(
            f"an empty {PARTIAL}",
            line,
            (),
            folder_at(PARTIAL),
            code=(0, 2),
            makes=("o.zarr", PARTIAL),
        ),
        Case(
            "hidden files of others beside an output",
            f"{PATTERNS} -o new",
            (),
            both(text(".new.mine"), text(".patterns.backup.png")),
            code=0,
        ),
    ]


CASES = [*_folders(), *_siblings()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_foreign(case: Case, work: Path) -> None:
    bear(case, work)
