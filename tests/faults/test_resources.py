"""D3 and D4: little memory, few threads, full disks, sizes beyond all machines."""

from __future__ import annotations

import os
from pathlib import Path

from ..case import Case, Limits, SkipError
from ..checks import every, same_matrix, within
from ..put import copy, folder_at, text
from ..work import PLAIN

ESTIMATE = f"{PLAIN} -o new.zarr"
COHERENT = "estimate capture -o new.zarr"
MIB = 1 << 20
LOW = (0, 3)


def _memory() -> list[Case]:
    cases = []
    for room in (8, 32, 96):
        for name, command in {
            "estimate": ESTIMATE,
            "coherent": COHERENT,
            "admm": f"{ESTIMATE} --solver saturation-admm --iterations 5",
            "romp": f"{ESTIMATE} --solver romp",
            "relight": "relight scene.zarr shown.png -o new.png",
            "simulate": "simulate T.npz --patterns patterns -o new",
        }.items():
            made = ("new.zarr", "new", "new.png")
            cases.append(
                Case(
                    f"{room} MiB of memory: {name}",
                    command,
                    (),
                    code=LOW,
                    makes=made,
                    # Where no memory is left to clean up, the next run of the output does it.
                    leaves=("new.zarr.partial", ".new.zarr.part"),
                    limits=Limits(memory=room * MIB),
                )
            )
    # Threads need room for their stacks; with little room there are no more threads.
    for room in (12, 40):
        for name, command in {"estimate": ESTIMATE, "coherent": COHERENT}.items():
            limits = Limits(memory=room * MIB, environment=(("RAYON_NUM_THREADS", "64"),))
            cases.append(
                Case(
                    f"64 threads in {room} MiB: {name}",
                    command,
                    (),
                    code=LOW,
                    makes=("new.zarr",),
                    # Where no memory is left to clean up, the next run of the output does it.
                    leaves=("new.zarr.partial", ".new.zarr.part"),
                    limits=limits,
                )
            )
    huge = {
        "patterns of 10^5 x 10^5 pixels": "patterns bernoulli -k 2 --size 100000x100000 -o new",
        "patterns of 2^31 pixels, blocks": "patterns blocks --size 46341x46341 --block 1x1 -o new",
        "10^9 patterns": "patterns bernoulli -k 1000000000 --size 8x8 -o new",
        "hadamard of 65536 x 65536": "patterns hadamard -k 4 --size 65536x65536 -o new",
        "a plan for 10^9 frames": "plan white.png --size 1024x1024 -k 1000000000",
        "a plan for a huge projector": "plan white.png --size 1000000x1000000",
        "a blur of 10^9 pixels": "simulate T.npz --patterns patterns --blur 1e9 -o new",
        "a render of 10^6 x 10^6": "render wall --size 1000000x1000000 --spp 1 -o new.npz",
    }
    for name, command in huge.items():
        fine = name.startswith(("a plan", "a blur"))
        cases.append(
            Case(
                name,
                command,
                (),
                code=(0, 2, 3) if fine else (2, 3),
                makes=("new",),
                limits=Limits(memory=1 << 30),
                check=within(20),
            )
        )
    bins = {"threads of 2^31": "2147483648", "threads below 0": "-1", "threads of a word": "many"}
    for name, value in bins.items():
        cases.append(
            Case(
                f"RAYON_NUM_THREADS: {name}",
                ESTIMATE,
                (),
                code=(0, 2, 3),
                makes=("new.zarr",),
                limits=Limits(environment=(("RAYON_NUM_THREADS", value),)),
            )
        )
    return cases


def _disks() -> list[Case]:
    cases = []
    commands = {
        "patterns": ("patterns bernoulli -k 4 --size 400x400 -o new", "new"),
        "simulate": ("simulate T.npz --patterns patterns -o new", "new"),
        "estimate": (ESTIMATE, "new.zarr"),
        "coherent": (COHERENT, "new.zarr"),
        "export npz": ("export scene.zarr new.npz", "new.npz"),
        "export mat": ("export scene.zarr new.mat --dense-background", "new.mat"),
        "relight": ("relight scene.zarr shown.png -o new.tif", "new.tif"),
    }
    for size in (0, 60, 1200):
        for name, (command, output) in commands.items():
            small = name == "relight" or (size == 1200 and name not in ("export mat", "patterns"))
            cases.append(
                Case(
                    f"files of at most {size} bytes: {name}",
                    command,
                    output if not small else (),
                    code=(0, 2) if small else 2,
                    makes=(output,),
                    leaves=("new.zarr.partial",) if size else (),
                    limits=Limits(file_size=size),
                )
            )
    for name, command, old in (
        ("patterns", "patterns bernoulli -k 4 --size 400x400 -o old --overwrite", "patterns"),
        ("export", "export scene.zarr old.npz --dense-background --overwrite", "plain.npz"),
    ):
        cases.append(
            Case(
                f"a full disk keeps the old {name}",
                command,
                "old",
                copy(old, "old" + Path(old).suffix),
                limits=Limits(file_size=100),
            )
        )
    cases += [
        Case(
            "a disk of 16 KiB",
            "patterns bernoulli -k 99 --size 64x64 -o disk/new",
            "disk/new",
            folder_at("disk"),
            limits=Limits(mount=("disk", 16384)),
        ),
        Case(
            "a disk of 16 KiB for an estimate",
            f"{PLAIN} -o disk/new.zarr",
            "disk/new.zarr",
            folder_at("disk"),
            limits=Limits(mount=("disk", 16384)),
        ),
        Case(
            "a capture on another disk than its link",
            f"{PLAIN} -o new.zarr",
            (),
            lambda folder: (folder / "disk").mkdir(),
            code=0,
            limits=Limits(mount=("disk", 1 << 20)),
            check=every(same_matrix("new.zarr", "plain.zarr")),
        ),
    ]
    return cases


def _rights() -> list[Case]:
    def closed(name: str, mode: int):  # type: ignore[no-untyped-def]
        def fault(folder: Path) -> None:
            if os.geteuid() == 0:
                raise SkipError("root may read and write everything")
            (folder / name).mkdir(exist_ok=True) if "." not in name else None
            (folder / name).chmod(mode)

        return fault

    return [
        Case(
            "an output folder that may not be written to",
            "patterns bernoulli -k 2 --size 8x8 -o locked/new",
            "locked/new",
            closed("locked", 0o500),
        ),
        Case(
            "a truth that may not be read",
            "simulate T.npz --patterns patterns -o new",
            "T.npz",
            closed("T.npz", 0),
        ),
        Case(
            "a picture that may not be read",
            "relight scene.zarr black.png -o new.png",
            "black.png",
            closed("black.png", 0),
        ),
        Case(
            "a capture.json that may not be read",
            "estimate capture -o new.zarr",
            "capture.json",
            closed("capture/capture.json", 0),
        ),
        Case(
            "a store that may not be read",
            "info scene.zarr",
            "scene.zarr",
            closed("scene.zarr/zarr.json", 0),
        ),
        Case(
            "a file where a folder for output should be",
            "patterns bernoulli -k 2 --size 8x8 -o there/new",
            "there",
            text("there"),
        ),
    ]


# What its cases need of the work folder.
NEEDS = (
    *(),
    *(
        "T.npz",
        "patterns",
        "capture",
        "scene.zarr",
        "plain.npz",
        "plain.zarr",
        "black.png",
        "shown.png",
        "white.png",
    ),
)

CASES = [*_memory(), *_disks(), *_rights()]
