"""Outputs replace only what this program wrote, and never anything but files and folders."""

from __future__ import annotations

from pathlib import Path

import pytest

from .case import Case, Prepare, bear
from .checks import every, holds, is_link
from .put import both, copy, device, folder_at, link, move, pipe, plug, remove, text
from .run import Limits, Ran, run

NEEDS = (
    *("T.npz", "patterns", "capture", "scene.zarr", "plain.npz", "plain.zarr", "photos"),
    *("projected", "black.png", "holiday.jpg", "shown.png"),
)
PATTERNS = "patterns bernoulli -k 2 --size 8x8"
SIMULATE = "simulate T.npz --patterns patterns"
ESTIMATE = "estimate capture --no-coherent"

# Every command with an output, without it; and the ending that it wants.
WRITERS = {
    "patterns": (f"{PATTERNS} -o", ""),
    "simulate": (f"{SIMULATE} -o", ""),
    "estimate": (f"{ESTIMATE} -o", ".zarr"),
    "relight png": ("relight scene.zarr shown.png -o", ".png"),
    "relight npy": ("relight scene.zarr shown.png -o", ".npy"),
    "show png": ("show scene.zarr dual -o", ".png"),
    "show npz": ("show scene.zarr correspondence -o", ".npz"),
    "info pictures": ("info scene.zarr --pictures", ""),
    "report": (f"{ESTIMATE} -o new.zarr --report", ""),
    "export npz": ("export scene.zarr", ".npz"),
    "export mat": ("export scene.zarr", ".mat"),
    "render": ("render wall --size 8x8 --spp 1 -o", ".npz"),
    "demo": ("demo -o", ""),
}


def _not_files() -> list[Case]:
    cases = [
        Case(
            f"{name} over a {put.__name__}", f"{line} out{end} --overwrite", "out", put(f"out{end}")
        )
        for put in (device, pipe, plug)
        for name, (line, end) in WRITERS.items()
    ]
    for name in ("patterns", "simulate", "relight png", "export npz"):
        line, end = WRITERS[name]
        linked = both(device("node"), link(f"out{end}", "node"))
        words = f"{name} over a link to a device"
        cases.append(Case(words, f"{line} out{end} --overwrite", "out", linked))
    return cases


def _places() -> list[Case]:
    # The current folder and those above it, each written in several ways; an empty name is the
    # current folder to pathlib.
    places = (".", "./", "..", "../..", "../work", "patterns/..", "../../outer", "''")
    over = f"{PATTERNS} -o {{}} --overwrite"
    ours = both(move("patterns/patterns.json", "patterns.json"), remove("patterns"))
    disk, inner = (Limits(mount=(name, 1 << 20)) for name in ("disk", "patterns/disk"))
    own = "relight scene.zarr shown.png -o shown.png"
    return [
        *(Case(f"patterns into {place}", f"{PATTERNS} -o {place}") for place in places),
        *(Case(f"patterns over {place}", over.format(place)) for place in places),
        Case("simulate into the current folder", f"{SIMULATE} -o . --overwrite"),
        Case("demo into the current folder", "demo -o . --overwrite"),
        Case("the current folder looks like ours", over.format("."), prepare=ours),
        Case("a mount point", over.format("disk"), "disk", folder_at("disk"), limits=disk),
        Case(
            "a folder that holds a mount point",
            over.format("patterns"),
            "patterns",
            folder_at("patterns/disk"),
            limits=inner,
        ),
        Case("simulate over its patterns", f"{SIMULATE} -o patterns --overwrite", "patterns"),
        Case(
            "estimate over its capture", f"{ESTIMATE} -o capture/../capture --overwrite", "capture"
        ),
        Case("relight over its own pattern", own, "shown.png"),
        Case("export over its own store", "export plain.zarr plain.zarr --overwrite", "plain.zarr"),
    ]


def _again(folder: Path) -> Ran:
    run("export scene.zarr own.mat", folder)
    return run("export plain.zarr own.mat --overwrite", folder)


def _files() -> list[Case]:
    relight = "relight scene.zarr shown.png -o"
    export = "export scene.zarr mine.npz --overwrite"
    foreign: dict[str, tuple[str, Prepare]] = {
        "export over a foreign npz": (export, text("mine.npz")),
        "export over a foreign mat": (export.replace("npz", "mat"), text("mine.mat")),
        "export over a folder": (export, text("mine.npz/photo.jpg")),
        "export over an empty folder": (export, folder_at("mine.npz")),
        # Images carry no marker, so that for images --overwrite is enough.
        "relight over a text called png": (f"{relight} mine.png --overwrite", text("mine.png")),
        "relight over a folder": (f"{relight} mine.png --overwrite", text("mine.png/photo.jpg")),
        "estimate over a file": (f"{ESTIMATE} -o mine.zarr --overwrite", text("mine.zarr")),
        "patterns over a file": (f"{PATTERNS} -o mine --overwrite", text("mine")),
    }
    kept = ("black.png", "--overwrite")
    return [
        *(Case(name, line, "mine", put) for name, (line, put) in foreign.items()),
        Case("export over our own npz", "export scene.zarr plain.npz --overwrite", code=0),
        Case("export over our own mat", code=0, scenario=_again, makes=("own.mat",)),
        Case("relight over a picture", f"{relight} black.png --overwrite", code=0),
        Case("relight over a picture, not asked to", f"{relight} black.png", kept),
    ]


def _links() -> list[Case]:
    outside = both(copy("patterns", "../kept"), link("out", "../kept"))
    target = link("out.npz", "target.npz")
    over, export = f"{PATTERNS} -o out --overwrite", "export scene.zarr out.npz"
    refused: dict[str, tuple[str, Prepare]] = {
        "to photographs": (over, both(text("../kept/photo.jpg"), link("out", "../kept"))),
        "to a foreign file": (f"{export} --overwrite", both(text("target.npz"), target)),
        "to itself": (over, link("out", "out")),
        "to the current folder": (over, link("out", ".")),
        "to nowhere, for an estimate": (f"{ESTIMATE} -o out", link("out", "gone/away.zarr")),
        "to nowhere, for patterns": (f"{PATTERNS} -o out", link("out", "gone/away")),
        "to nowhere, for an export": (export, link("out.npz", "gone/away.npz")),
    }
    return [
        *(Case(f"a link {w}", line, "out|kept|npz", put) for w, (line, put) in refused.items()),
        Case(
            "a link to our own folder is followed",
            over,
            (),
            outside,
            code=0,
            makes=("../kept",),
            check=every(is_link("out"), holds("../kept/pattern_0001.png")),
        ),
        Case(
            "a link to our own file is followed",
            f"{export} --overwrite",
            (),
            both(copy("plain.npz", "target.npz"), target),
            code=0,
            makes=("target.npz",),
            check=is_link("out.npz"),
        ),
        Case(
            "a linked folder above the output",
            f"{PATTERNS} -o way/out",
            (),
            both(folder_at("real"), link("way", "real")),
            code=0,
            makes=("real/out",),
            check=holds("real/out/pattern_0001.png"),
        ),
    ]


CASES = [*_not_files(), *_places(), *_files(), *_links()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_outputs(case: Case, work: Path) -> None:
    bear(case, work)
