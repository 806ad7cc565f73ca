"""Arguments are checked before anything is written, and odd ones have a message."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.cli import main

from .case import Case, Check, bear, judge, snapshot
from .checks import holds, prints
from .put import array, both, copy, link, move, remove, text
from .run import Ran, run
from .work import PLAIN, SHAPE, fresh_copy

NEEDS = (
    *("T.npz", "patterns", "capture", "scene.zarr", "photos", "projected", "black.png"),
    *("holiday.jpg", "shown.png", "white.png"),
)
SIMULATE = "simulate T.npz --patterns patterns -o new"
ESTIMATE = "estimate capture --no-coherent -o new.zarr"
PATTERNS = "patterns bernoulli -k 4 --size 8x8 -o new"
TWO = "patterns bernoulli -k 2 --size 8x8 -o"
RELIGHT = "relight scene.zarr shown.png -o new.png"
COMPENSATE = "compensate scene.zarr shown.png -o new.png"
PLAN = "plan white.png --size 8x8"
FOLDERS = "estimate --patterns projected --images photos --no-coherent -o new.zarr"

# Command -> option -> values that make no sense. Each is refused, and the option is named.
VALUES: dict[str, dict[str, tuple[str, ...]]] = {
    SIMULATE: {
        "--leak": ("nan", "1", "-1"),
        "--ambient": ("inf", "nan", "-1"),
        "--vignetting": ("nan", "-1", "1"),
        "--noise": ("1e308", "nan"),
        "--full-well": ("1e308", "nan", "-1", "0"),
        "--blur": ("inf", "nan", "-1", "1e308"),
        "--black-level": ("nan", "-1", "255", "1e308"),
        "--exposure": ("inf", "0", "1e300", "1:nan", "1:2", "a", "''"),
        "--bits": ("0", "7", "-8", "4294967296"),
        "--seed": ("-1", "18446744073709551616", "1.5"),
    },
    ESTIMATE: {
        "--regularization": ("0", "nan", "1e308", "1e-320", "''", "0.3.1"),
        "--iterations": ("0", "4294967296", "18446744073709551616"),
        "--tile-rows": ("0", "-3"),
        "--bin-camera": ("0", "8x", "99999999999999999999999"),
        "--bin-projector": ("0x0", "99999999999999999999999"),
    },
    FOLDERS: {
        "--clip": ("nan", "0", "1e308"),
        "--response": (
            *("gamma:nan", "gamma:inf", "gamma:0", "gamma:", "gamma:1e308", "curve:", "''"),
            *("curve:nowhere.txt", "curve:photos", "SRGB2"),
        ),
        "--black": ("nowhere.png", "photos", "holiday.jpg"),
        "--mask": ("nowhere.png", "photos"),
        "--white": ("nowhere.png", "holiday.jpg"),
    },
    PATTERNS: {
        "--size": ("0x8", "8x0", "8x8x8", "-8", "''", "99999999999999999999x1", "1000000x1000000"),
        "-k": ("0", "-1", "1.5", "9223372036854775808"),
        "--density": ("nan", "0", "1"),
        "--seed": ("-1",),
        "--mix": ("fine:1",),
    },
    "patterns blocks --size 8x8 -o new": {"--block": ("0x0", "-1", "x"), "-k": ("0", "9")},
    "patterns mix -k 64 --size 8x8 -o new": {
        "--mix": ("fine:nan", "fine:-1,4x4:2", "99x99:1", "0x0:1", "fine:0.5,fine:0.5", "²x²:1")
    },
    RELIGHT: {"--exposure": ("nan", "0", "1e308"), "--gamma": ("nan", "0", "1e-308")},
    COMPENSATE: {
        "--brightness": ("nan", "0", "bright"),
        "--exposure": ("nan", "0", "1e308"),
        "--gamma": ("nan", "0", "1e-308"),
        "--black": ("nowhere.png", "photos", "holiday.jpg"),
        "--mask": ("nowhere.png", "photos"),
    },
    "evaluate scene.zarr --truth T.npz": {"--exposure": ("nan", "inf", "0")},
    PLAN: {
        "--error": ("nan", "1"),
        "--noise": ("nan", "1e308"),
        "--exposure": ("nan", "0"),
        "--shortest": ("nan", "0"),
        "--black": ("nowhere.png",),
        "-k": ("1", "-1", "9223372036854775808"),
        "--size": ("0", "99999999999999999999"),
    },
    "render wall --spp 2 -o new.npz --size 4x4": {
        "--keep": ("nan", "2"),
        "--seed": ("18446744073709551616",),
        "--projector-size": ("0", "x"),
    },
}
# Where a command's usual message names the thing in words of its own.
WORDS = {
    "--bin-camera": "size|bin|block",
    "--bin-projector": "size|bin|block|1 x 1",
    "--tile-rows": "tile",
    "--black-level": "black|raw level",
    "-k": "-k|count|pattern|frames",
    "--iterations": "iteration|rounds|passes",
    "--size": "size|pixels|projector",
    "--block": "size|block",
    "--mix": "mix|grid",
    "--full-well": "full well",
    "--projector-size": "size",
    "--white": "nowhere.png|holiday.jpg",
    "--mask": "nowhere.png|photos",
    "--keep": "keep|share|energy",
}


@pytest.fixture(scope="module")
def untouched(template: Path) -> Iterator[Path]:
    """A folder in which refused commands change nothing."""
    with fresh_copy(template, NEEDS) as place:
        before = snapshot(place)
        yield place
        assert snapshot(place) == before


@pytest.mark.parametrize(("command", "option"), [(c, o) for c in VALUES for o in VALUES[c]])
def test_values_that_make_no_sense(
    command: str, option: str, untouched: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(untouched)
    for value in VALUES[command][option]:
        says = WORDS.get(option, option.lstrip("-"))
        if value.startswith(("nowhere", "photos", "holiday")):
            says = value
        line = f"{command} {option}{'=' if option.startswith('--') else ' '}{value}"
        if option == "-k" and " -k " in command:
            line = command.replace(" -k 4", f" -k {value}")
        ran = Ran(main(shlex.split(line)), *capsys.readouterr())
        assert judge(Case(line, line, says), ran, {}, {}) is None, line


def _first_wrong_then_right() -> list[Case]:
    """What failed must not stand in the way of the correct command."""
    right = f"{PLAIN} -o new.zarr"
    wrong = {
        "a regularization of 0": (f"{right} --regularization 0", "regularization", right),
        "a regularization of words": (f"{right} --regularization much", "much", right),
        "a capture that is missing": ("estimate nowhere -o new.zarr", "nowhere", right),
        "an unknown solver": (f"{right} --solver best", "best", right),
        "a folder that would be made": (
            f"{PLAIN} --regularization 0 -o deep/er/new.zarr",
            "regularization",
            f"{PLAIN} -o deep/er/new.zarr",
        ),
        "a gamma for linear light": (
            "relight scene.zarr shown.png -o new.tiff --gamma 2.2",
            "gamma",
            RELIGHT,
        ),
        "a pattern that is missing": (
            "relight scene.zarr black8.png -o deep/new.png",
            "black8.png|no such file",
            "relight scene.zarr shown.png -o deep/new.png",
        ),
        "a mask of another size": (
            f"{COMPENSATE} --mask wide.npy",
            "wide.npy has shape",
            COMPENSATE,
        ),
        "a wanted picture that is all black": (
            "compensate scene.zarr dark.npy -o new.png",
            "dark.npy is all black",
            COMPENSATE,
        ),
        "a mask that leaves nothing": (
            f"{COMPENSATE} --mask none.npy",
            "none.npy leaves no camera pixel",
            COMPENSATE,
        ),
        "patterns of an unknown kind": ("patterns noise -o new", "noise", PATTERNS),
    }
    pictures = both(
        array("wide.npy", np.ones((3, 5), np.float32)),
        array("dark.npy", np.zeros((4, 4), np.float32)),
        array("none.npy", np.zeros(SHAPE, np.float32)),
    )
    return [
        Case(f"{name}, then the right command", command, says, pictures, then=then)
        for name, (command, says, then) in wrong.items()
    ]


def _same_as_lower_case(folder: Path, ran: Ran) -> str | None:
    run(f"{RELIGHT} --gamma 2.2", folder)
    same = (folder / "new.png").read_bytes() == (folder / "b.PNG").read_bytes()
    return None if same else "b.PNG is not what new.png is"


def _odd_but_fine() -> list[Case]:
    """Endings in capitals, and names that a terminal or a shell would take for something else."""
    capitals = move("T.npz", "T.NPZ")
    upper = f"{RELIGHT.replace('new.png', 'b.PNG')} --gamma 2.2"
    # Command -> what it must print or make.
    printed: dict[str, Check | None] = {
        f"{TWO} [red]": prints("[red]"),
        f"{TWO} :smile:": prints(":smile:"),
        f"{TWO} 'caf\udce9'": None,  # not UTF-8
        f"{TWO} 'a\nb'": None,
        "export scene.zarr '[/red].npz'": prints("[/red].npz"),
        f"{PLAIN} -o '[/s].zarr'": prints("[/s].zarr"),
        "export scene.zarr T.NPZ": holds("T.NPZ"),
        "export scene.zarr T.MAT": holds("T.MAT"),
        upper: _same_as_lower_case,
        # Useless, but what is asked for can be done.
        f"{PATTERNS} --seed 18446744073709551615": None,
    }
    return [
        *(Case(f"fine: {line}", line, code=0, check=check) for line, check in printed.items()),
        Case("a truth T.NPZ", "evaluate scene.zarr --truth T.NPZ", (), capitals, code=0),
        Case("simulate T.NPZ", SIMULATE.replace("npz", "NPZ"), (), capitals, code=0),
        Case("a plan of T.NPZ", "plan T.NPZ --size 8x8", (), capitals, code=0),
        Case(
            "a picture x[/y].png relit",
            "relight scene.zarr 'x[/y].png' -o 'out[/z].png'",
            (),
            copy("shown.png", "x[/y].png"),
            code=0,
            check=prints("out[/z].png"),
        ),
        *(
            Case(
                f"a store called {name} is named",
                f"info '{name}'",
                (),
                copy("scene.zarr", name),
                code=0,
                check=prints(name),
            )
            for name in ("[b].zarr", ":boom:.zarr")
        ),
    ]


def _names() -> list[Case]:
    long = "a" * 300
    broken = "relight scene.zarr 'x[/y].png' -o new.png"
    below = f"{TWO} holiday.jpg/new"
    fewer = remove("photos/image_0003.png")
    return [
        Case("a broken picture x[/y].png", broken, "x[/y].png", text("x[/y].png")),
        Case("a missing x[/y].png planned from", "plan 'x[/y].png' --size 8x8", "x[/y].png"),
        Case("markup in an option", "patterns bernoulli --size '[/bold]' -o new", "[/bold]"),
        Case("no words at all for estimate", "estimate", "no capture is given"),
        Case("an unknown command", "photograph", "photograph"),
        Case("an unknown option", f"{PATTERNS} --shade red", "--shade"),
        *(
            Case(f"a name of 300 letters: {line.split()[0]} {number}", line, "aaa")
            for number, line in enumerate(
                (
                    f"{TWO} {long}",
                    f"estimate {long} -o new.zarr",
                    f"info {long}.zarr",
                    SIMULATE.replace("T.npz", f"{long}.npz"),
                    f"relight scene.zarr {long}.png -o new.png",
                    f"{FOLDERS} --response curve:{long}",
                )
            )
        ),
        *(
            Case(f"a link to itself: {line.split()[0]}", line, says, link(name, name))
            for name, line, says in (
                ("loop", f"{TWO} loop/new", "new|loop"),
                ("loop.zarr", "info loop.zarr", "loop.zarr"),
                ("loop.npz", SIMULATE.replace("T.npz", "loop.npz"), "loop.npz"),
                ("loop", "estimate loop -o new.zarr", "loop"),
            )
        ),
        Case("a name with a null byte", "info 'a\0b.zarr'", "zarr|null"),
        Case("a path below a file", "info holiday.jpg/scene.zarr", "scene.zarr"),
        Case("an output below a file", below, "new"),
        Case("too many patterns", "patterns hadamard -k 5000 --size 8x8 -o new", "5000|pattern"),
        Case("both a capture and folders", f"{ESTIMATE} --images photos", "--images"),
        Case("frames and patterns that differ in number", FOLDERS, "31 images", fewer),
    ]


CASES = [*_first_wrong_then_right(), *_odd_but_fine(), *_names()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_arguments(case: Case, work: Path) -> None:
    bear(case, work)
