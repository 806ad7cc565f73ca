"""C: outputs replace only what this program wrote, and never anything but files and folders."""

from __future__ import annotations

from ..case import Case, Limits, Prepare
from ..checks import every, holds, is_link
from ..put import both, copy, device, folder_at, link, move, pipe, plug, remove, text

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
    "show png": ("show scene.zarr --dual -o", ".png"),
    "show npz": ("show scene.zarr --correspondence -o", ".npz"),
    "info pictures": ("info scene.zarr --pictures", ""),
    "report": (f"{ESTIMATE} -o new.zarr --report", ""),
    "export npz": ("export scene.zarr", ".npz"),
    "export mat": ("export scene.zarr", ".mat"),
    "render": ("render wall --size 8x8 --spp 1 -o", ".npz"),
    "demo": ("demo -o", ""),
    "scenes": ("scenes --thumbnails", ""),
}


def _not_files() -> list[Case]:
    cases = []
    for what, put in {"device": device, "pipe": pipe, "socket": plug}.items():
        for name, (command, ending) in WRITERS.items():
            output = f"out{ending}"
            cases.append(
                Case(
                    f"{name} over a {what}",
                    f"{command} {output} --overwrite",
                    output,
                    put(output),
                    # Refused at once, long before anything is computed.
                    seconds=8,
                )
            )
    for name in ("patterns", "simulate", "relight png", "export npz"):
        command, ending = WRITERS[name]
        output = f"out{ending}"
        linked = both(device("node"), link(output, "node"))
        cases.append(
            Case(
                f"{name} over a link to a device", f"{command} {output} --overwrite", "out", linked
            )
        )
    return cases


def _places() -> list[Case]:
    cases = []
    # The current folder and those above it, each written in several ways.
    places = (".", "./", "..", "../..", "../work", "patterns/..", "../../outer", "''")
    for place in places:
        for overwrite in ("", " --overwrite"):
            name = f"patterns into {place}{overwrite}"
            # An empty name is the current folder to pathlib.
            cases.append(Case(name, f"{PATTERNS} -o {place}{overwrite}"))
    ours = both(move("patterns/patterns.json", "patterns.json"), remove("patterns"))
    cases += [
        Case("simulate into the current folder", f"{SIMULATE} -o . --overwrite"),
        Case("demo into the current folder", "demo -o . --overwrite"),
        Case(
            "patterns into the current folder that looks like ours",
            f"{PATTERNS} -o . --overwrite",
            prepare=ours,
        ),
        Case(
            "patterns over a mount point",
            f"{PATTERNS} -o disk --overwrite",
            "disk",
            folder_at("disk"),
            limits=Limits(mount=("disk", 1 << 20)),
        ),
        Case(
            "patterns over a folder that holds a mount point",
            f"{PATTERNS} -o patterns --overwrite",
            "patterns",
            folder_at("patterns/disk"),
            limits=Limits(mount=("patterns/disk", 1 << 20)),
        ),
        Case("patterns over their own input", f"{SIMULATE} -o patterns --overwrite", "patterns"),
        Case(
            "estimate over its capture's folder",
            f"{ESTIMATE} -o capture/../capture --overwrite",
            "capture",
        ),
        Case(
            "relight over its own pattern",
            "relight scene.zarr shown.png -o shown.png",
            "shown.png",
        ),
        Case("export over its own store", "export plain.zarr plain.zarr --overwrite", "plain.zarr"),
    ]
    return cases


def _files() -> list[Case]:
    relight = "relight scene.zarr shown.png"
    return [
        Case(
            "export over a foreign npz",
            "export scene.zarr mine.npz --overwrite",
            "mine.npz",
            text("mine.npz"),
        ),
        Case(
            "export over a foreign mat",
            "export scene.zarr mine.mat --overwrite",
            "mine.mat",
            text("mine.mat"),
        ),
        Case(
            "export over a folder",
            "export scene.zarr mine.npz --overwrite",
            "mine.npz",
            text("mine.npz/photo.jpg"),
        ),
        Case(
            "export over an empty folder",
            "export scene.zarr mine.npz --overwrite",
            "mine.npz",
            folder_at("mine.npz"),
        ),
        Case(
            "export over our own npz",
            "export scene.zarr plain.npz --overwrite",
            code=0,
            makes=("plain.npz",),
        ),
        Case(
            "export over our own mat",
            "export scene.zarr own.mat --overwrite",
            (),
            code=0,
            scenario=lambda folder, run: (
                run("export scene.zarr own.mat"),
                run("export plain.zarr own.mat --overwrite"),
            )[1],
            makes=("own.mat",),
        ),
        Case("relight over a picture", f"{relight} -o black.png --overwrite", code=0),
        # Images carry no marker, so that for images --overwrite is enough.
        Case(
            "relight over a text that is called png",
            f"{relight} -o notes.png --overwrite",
            "notes.png",
            text("notes.png"),
        ),
        Case(
            "relight over a folder",
            f"{relight} -o mine.png --overwrite",
            "mine.png",
            text("mine.png/photo.jpg"),
        ),
        Case(
            "relight over a picture, not asked to",
            f"{relight} -o black.png",
            ("black.png", "--overwrite"),
        ),
        Case("patterns over a file", f"{PATTERNS} -o holiday.jpg --overwrite", "holiday.jpg"),
        Case(
            "estimate over a file",
            f"{ESTIMATE} -o mine.zarr --overwrite",
            "mine.zarr",
            text("mine.zarr"),
        ),
    ]


def _links() -> list[Case]:
    outside = both(copy("patterns", "../kept"), link("out", "../kept"))
    photographs = both(text("../kept/photo.jpg"), link("out", "../kept"))

    def of_file(put: Prepare) -> Prepare:
        return both(put, link("out.npz", "target.npz"))

    return [
        Case(
            "a link to our own folder is followed",
            f"{PATTERNS} -o out --overwrite",
            (),
            outside,
            code=0,
            makes=("../kept",),
            check=every(is_link("out"), holds("../kept/pattern_0001.png")),
        ),
        Case("a link to photographs", f"{PATTERNS} -o out --overwrite", "kept|out", photographs),
        Case(
            "a link to our own file is followed",
            "export scene.zarr out.npz --overwrite",
            (),
            of_file(copy("plain.npz", "target.npz")),
            code=0,
            makes=("target.npz",),
            check=is_link("out.npz"),
        ),
        Case(
            "a link to a foreign file",
            "export scene.zarr out.npz --overwrite",
            "npz",
            of_file(text("target.npz")),
        ),
        Case("a link to itself", f"{PATTERNS} -o out --overwrite", "out", link("out", "out")),
        Case(
            "a link that leads nowhere, for an estimate",
            f"{ESTIMATE} -o out.zarr",
            "out.zarr",
            link("out.zarr", "gone/away.zarr"),
        ),
        Case(
            "a link that leads nowhere, for patterns",
            f"{PATTERNS} -o out",
            "out",
            link("out", "gone/away"),
        ),
        Case(
            "a link that leads nowhere, for an export",
            "export scene.zarr out.npz",
            "out.npz",
            link("out.npz", "gone/away.npz"),
        ),
        Case(
            "a link to the current folder",
            f"{PATTERNS} -o out --overwrite",
            "out",
            link("out", "."),
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

CASES = [*_not_files(), *_places(), *_files(), *_links()]
