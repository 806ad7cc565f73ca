"""Little memory, few threads, full disks, sizes beyond all machines."""

from __future__ import annotations

from pathlib import Path

import pytest

from .case import Case, bear
from .checks import same_matrix
from .put import copy, folder_at, text
from .run import Limits
from .work import PLAIN

NEEDS = (
    *("T.npz", "patterns", "capture", "scene.zarr", "plain.npz", "plain.zarr", "black.png"),
    *("shown.png", "white.png"),
)
ESTIMATE = f"{PLAIN} -o new.zarr"
COHERENT = "estimate capture -o new.zarr"
SIMULATE = "simulate T.npz --patterns patterns -o new"


def _memory() -> list[Case]:
    commands = {
        "estimate": ESTIMATE,
        "coherent": COHERENT,
        "admm": f"{ESTIMATE} --solver saturation-admm --iterations 5",
        "romp": f"{ESTIMATE} --solver romp",
        "relight": "relight scene.zarr shown.png -o new.png",
        "simulate": SIMULATE,
    }
    # Threads need room for their stacks; with little room there are no more threads.
    threads = (("RAYON_NUM_THREADS", "64"),)
    little = [
        *((96, name, ()) for name in commands),
        *((8, name, ()) for name in ("coherent", "simulate")),
        (12, "coherent", threads),
    ]
    return [
        Case(
            f"{room} MiB of memory{', 64 threads' if many else ''}: {name}",
            commands[name],
            (),
            code=0 if (room, name) == (96, "relight") else (0, 3),
            # Where no memory is left to clean up, the next run of the output does it.
            leaves=("new.zarr.partial", ".new.zarr.part"),
            limits=Limits(memory=room << 20, environment=many),
        )
        for room, name, many in little
    ]


def _sizes() -> list[Case]:
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
    return [
        *(Case(name, command, limits=Limits(memory=1 << 30)) for name, command in huge.items()),
        *(
            Case(
                f"{value} threads",
                ESTIMATE,
                (),
                code=(0, 3) if value.isdigit() else 0,
                # Without a limit the system makes thousands of threads, which takes seconds.
                limits=Limits(memory=1 << 30, environment=(("RAYON_NUM_THREADS", value),)),
            )
            for value in ("2147483648", "-1", "many")
        ),
    ]


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
    for size in (60, 1200):
        for name, (command, output) in commands.items():
            small = name == "relight" or (size == 1200 and name not in ("export mat", "patterns"))
            cases.append(
                Case(
                    f"files of at most {size} bytes: {name}",
                    command,
                    output if not small else (),
                    code=(0, 2) if small else 2,
                    leaves=("new.zarr.partial",),
                    limits=Limits(file_size=size),
                )
            )
    full, disk, large = (
        Limits(file_size=100),
        *(Limits(mount=("disk", n)) for n in (1 << 14, 1 << 20)),
    )
    place = folder_at("disk")
    replaced = {
        "patterns": f"{commands['patterns'][0][:-3]}old --overwrite",
        "plain.npz": "export scene.zarr old.npz --dense-background --overwrite",
    }
    many = "patterns bernoulli -k 99 --size 64x64 -o disk/new"
    same = same_matrix("new.zarr", "plain.zarr")
    return [
        *cases,
        *(
            Case(f"{old} of old", line, "old", copy(old, f"old{Path(old).suffix}"), limits=full)
            for old, line in replaced.items()
        ),
        Case("a disk of 16 KiB", many, "disk/new", place, limits=disk),
        Case("an estimate on it", f"{PLAIN} -o disk/new.zarr", "disk/new.zarr", place, limits=disk),
        Case("another disk", ESTIMATE, (), place, code=0, limits=large, check=same),
    ]


IN_THE_WAY = Case(
    "a file where a folder for output should be",
    "patterns bernoulli -k 2 --size 8x8 -o there/new",
    "there",
    text("there"),
)
CASES = [*_memory(), *_sizes(), *_disks(), IN_THE_WAY]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_resources(case: Case, work: Path) -> None:
    bear(case, work)
