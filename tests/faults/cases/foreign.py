"""C: what others have put where an output is to go, or beside it."""

from __future__ import annotations

from pathlib import Path

from ..case import Case
from ..checks import every, holds, prints
from ..put import both, copy, folder_at, link, text
from .outputs import ESTIMATE, PATTERNS, SIMULATE

# Files of ours; their names alone must not make a folder one of ours.
NAMES = ("capture.json", "patterns.json", "zarr.json", "scenes.json", "demo.json", "fig4.json")
HAND_WRITTEN = '{"format": "lightmatrix-capture", "version": 1, "exposure": 0.5}\n'


def _foreign() -> list[Case]:
    cases = []
    for name in NAMES:
        for content, kind in (
            (HAND_WRITTEN, "ours by its words"),
            ("{}", "empty"),
            ("", "of 0 bytes"),
        ):
            cases.append(
                Case(
                    f"a folder of photographs with a {name}, {kind}",
                    f"{PATTERNS} -o mine --overwrite",
                    "mine",
                    both(text(f"mine/{name}", content), text("mine/photo.jpg")),
                )
            )
    ours = {"patterns": PATTERNS, "capture": SIMULATE, "scene.zarr": ESTIMATE}
    additions = ("holiday.jpg", ".notes", "more/raw.dng", "images/image_9999.png")
    for folder, command in ours.items():
        # Capture is estimated from, so it is written to a copy.
        for addition in additions:
            cases.append(
                Case(
                    f"{folder} with one foreign file {addition}",
                    f"{command} -o old{Path(folder).suffix} --overwrite",
                    "old",
                    both(
                        copy(folder, f"old{Path(folder).suffix}"),
                        text(f"old{Path(folder).suffix}/{addition}"),
                    ),
                )
            )
        cases.append(
            Case(
                f"{folder} of ours is replaced",
                f"{command} -o old{Path(folder).suffix} --overwrite",
                (),
                copy(folder, f"old{Path(folder).suffix}"),
                code=0,
            )
        )
        cases.append(
            Case(
                f"{folder} of ours is kept without --overwrite",
                f"{command} -o {folder}",
                ("exists", "--overwrite"),
            )
        )
    photographs = text("capture/images/image_0000.png", "another photograph, longer than any")
    cases += [
        Case(
            "photographs and a hand-written capture.json, as the docs tell",
            f"{PATTERNS} -o cap --overwrite",
            "cap",
            both(copy("photos", "cap/images"), text("cap/capture.json", HAND_WRITTEN)),
        ),
        Case(
            "a whole hand-made capture",
            f"{SIMULATE} -o cap --overwrite",
            "cap",
            both(
                copy("photos", "cap/images"),
                copy("projected", "cap/patterns"),
                text("cap/capture.json", HAND_WRITTEN),
            ),
        ),
        Case("photographs alone", f"{PATTERNS} -o photos --overwrite", "photos", photographs),
        Case(
            "another program's Zarr store",
            f"{ESTIMATE} -o other.zarr --overwrite",
            "other.zarr",
            text("other.zarr/zarr.json", '{"zarr_format": 3, "node_type": "group"}'),
        ),
        Case(
            "another program's Zarr store with a format of its own",
            f"{ESTIMATE} -o other.zarr --overwrite",
            "other.zarr",
            text(
                "other.zarr/zarr.json",
                '{"zarr_format": 3, "node_type": "group", "attributes": {"format": "ome"}}',
            ),
        ),
        Case("an empty folder is filled", f"{PATTERNS} -o new", (), folder_at("new"), code=0),
    ]
    return cases


def _siblings() -> list[Case]:
    return [
        Case(
            "a folder o.zarr.partial that is not an estimate's",
            f"{ESTIMATE} -o o.zarr",
            "o.zarr.partial",
            text("o.zarr.partial/photo.jpg"),
        ),
        Case(
            "a foreign o.zarr.partial and --overwrite",
            f"{ESTIMATE} -o o.zarr --overwrite",
            "o.zarr.partial",
            text("o.zarr.partial/photo.jpg"),
        ),
        Case(
            "a foreign npz in o.zarr.partial and --overwrite",
            f"{ESTIMATE} -o o.zarr --overwrite",
            "o.zarr.partial",
            both(
                text("o.zarr.partial/rows-0-9.npz"), text("o.zarr.partial/fingerprint.json", "{}")
            ),
        ),
        Case(
            "a file o.zarr.partial",
            f"{ESTIMATE} -o o.zarr",
            "o.zarr.partial",
            text("o.zarr.partial"),
        ),
        Case(
            "a link o.zarr.partial to photographs",
            f"{ESTIMATE} -o o.zarr",
            "o.zarr.partial",
            link("o.zarr.partial", "photos"),
        ),
        Case(
            "an empty o.zarr.partial",
            f"{ESTIMATE} -o o.zarr",
            (),
            folder_at("o.zarr.partial"),
            code=(0, 2),
            makes=("o.zarr", "o.zarr.partial"),
        ),
        Case(
            "hidden files of others beside an output",
            f"{PATTERNS} -o new",
            (),
            both(text(".new.mine"), text(".patterns.backup.png")),
            code=0,
        ),
        Case(
            "a name of brackets for patterns",
            f"{PATTERNS} -o 'a[/b]'",
            (),
            code=0,
            check=every(holds("a[/b]/pattern_0001.png"), prints("a[/b]")),
        ),
    ]


# What its cases need of the work folder.
NEEDS = (
    *(
        "T.npz",
        "patterns",
        "capture",
        "scene.zarr",
        "plain.npz",
        "plain.zarr",
        "photos",
        "projected",
        "black.png",
        "holiday.jpg",
        "shown.png",
    ),
)

CASES = [*_foreign(), *_siblings()]
