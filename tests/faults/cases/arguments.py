"""Arguments are checked before anything is written, and odd ones have a message."""

from __future__ import annotations

import numpy as np

from ..case import Case, nothing
from ..checks import every, holds, prints
from ..put import array, both, copy, link, move, remove, text
from ..work import PLAIN, SHAPE

SIMULATE = "simulate T.npz --patterns patterns -o new"
ESTIMATE = "estimate capture --no-coherent -o new.zarr"
PATTERNS = "patterns bernoulli -k 4 --size 8x8 -o new"
RELIGHT = "relight scene.zarr shown.png -o new.png"
COMPENSATE = "compensate scene.zarr shown.png --resize -o new.png"
PLAN = "plan white.png --size 8x8"
FOLDERS = "estimate --patterns projected --images photos --no-coherent -o new.zarr"

# Command -> option -> values that make no sense. Each is refused, and the option is named.
REFUSED: dict[str, dict[str, tuple[str, ...]]] = {
    SIMULATE: {
        "--leak": ("nan", "-1", "1.5", "inf"),
        "--ambient": ("inf", "nan", "-1"),
        "--vignetting": ("nan", "-1", "2"),
        "--noise": ("1e308", "nan", "-1", "inf"),
        "--shot-noise": ("1e308", "nan", "-1"),
        "--blur": ("inf", "nan", "-1", "1e308"),
        "--black": ("nan", "-1", "255", "1e308"),
        "--exposure": ("inf", "nan", "0", "-1", "1:nan", "1:2", "a", "''"),
        "--bits": ("0", "7", "-8", "4294967296"),
        "--seed": ("-1", "18446744073709551616", "1.5"),
    },
    ESTIMATE: {
        "--regularization": ("0", "-1", "nan", "inf", "1e308", "1e-320", "''", "0.3.1"),
        "--iterations": ("0", "-1", "4294967296", "9223372036854775808", "18446744073709551616"),
        "--tile-rows": ("0", "-3"),
        "--bin-camera": ("0", "-1", "1.5", "8x", "99999999999999999999999"),
        "--bin-projector": ("0x0", "99999999999999999999999"),
    },
    FOLDERS: {
        "--clip": ("nan", "inf", "0", "-1", "1e308"),
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
        "--density": ("nan", "0", "1", "-1", "inf"),
        "--seed": ("-1",),
        "--mix": ("fine:1",),
    },
    "patterns blocks --size 8x8 -o new": {"--block": ("0x0", "-1", "x"), "-k": ("0", "9")},
    "patterns mix -k 64 --size 8x8 -o new": {
        "--mix": ("fine:nan", "fine:-1,4x4:2", "99x99:1", "0x0:1", "fine:0.5,fine:0.5", "²x²:1"),
    },
    RELIGHT: {
        "--exposure": ("nan", "inf", "0", "-1", "1e308"),
        "--gamma": ("nan", "inf", "0", "-1", "1e-308"),
    },
    COMPENSATE: {
        "--brightness": ("nan", "inf", "0", "-1", "bright"),
        "--exposure": ("nan", "inf", "0", "-1", "1e308"),
        "--gamma": ("nan", "inf", "0", "-1", "1e-308"),
        "--black": ("nowhere.png", "photos", "holiday.jpg"),
        "--mask": ("nowhere.png", "photos"),
    },
    "evaluate scene.zarr --truth T.npz": {"--exposure": ("nan", "inf", "0")},
    PLAN: {
        "--error": ("nan", "0", "1", "-1"),
        "--noise": ("nan", "-1", "inf", "1e308"),
        "--exposure": ("nan", "inf", "0", "-1"),
        "--shortest": ("nan", "0", "-1", "inf"),
        "--black": ("nowhere.png",),
        "-k": ("1", "-1", "9223372036854775808"),
        "--size": ("0", "99999999999999999999"),
    },
    "render wall --spp 2 -o new.npz --size 4x4": {
        "--keep": ("nan", "0", "-1", "2"),
        "--seed": ("18446744073709551616",),
        "--projector-size": ("0", "x"),
    },
}
# Where a command's usual message names the thing in words of its own.
WORDS = {
    "--bin-camera": "size|bin|block",
    "--bin-projector": "size|bin|block|1 x 1",
    "--tile-rows": "tile",
    "-k": "-k|count|pattern|frames",
    "--iterations": "iteration|rounds|passes",
    "--size": "size|pixels|projector",
    "--block": "size|block",
    "--mix": "mix|grid",
    "--shot-noise": "noise",
    "--projector-size": "size",
    "--white": "nowhere.png|holiday.jpg",
    "--mask": "nowhere.png|photos",
    "--keep": "keep|share|energy",
}


def _named(command: str) -> str:
    """The command, and the kind of patterns."""
    words = command.split()
    return " ".join(words[:2]) if words[0] == "patterns" else words[0]


def _refused() -> list[Case]:
    cases = []
    for command, options in REFUSED.items():
        for option, values in options.items():
            for value in values:
                words = WORDS.get(option, option.lstrip("-"))
                if value.startswith(("nowhere", "photos", "holiday")):
                    words = value
                words_of_option = (
                    f"{option}={value}" if option.startswith("--") else f"{option} {value}"
                )
                if option == "-k" and " -k " in command:
                    line = command.replace(" -k 4", f" -k {value}")
                else:
                    line = f"{command} {words_of_option}"
                cases.append(Case(f"{_named(command)} {option} {value}", line, words))
    for line in (
        # Useless, but what is asked for can be done: all rows in one tile, any seed, much light.
        f"{ESTIMATE} --tile-rows 99999999999999999999",
        f"{PATTERNS} --seed 18446744073709551616",
        f"{SIMULATE} --exposure 1e308",
        "evaluate scene.zarr --truth T.npz --exposure 1e-320",
    ):
        cases.append(Case(f"odd but possible: {line}", line, code=(0, 2)))
    return cases


def _first_wrong_then_right() -> list[Case]:
    """What failed must not stand in the way of the correct command."""
    right = f"{PLAIN} -o new.zarr"
    wrong = {
        "a regularization of 0": (f"{right} --regularization 0", "regularization", right),
        "a regularization of words": (f"{right} --regularization much", "much", right),
        "a capture that is missing": ("estimate nowhere -o new.zarr", "nowhere", right),
        "an unknown solver": (f"{right} --solver best", "best", right),
        "a folder that would be made": (
            "estimate capture --regularization 0 -o deep/er/new.zarr",
            "regularization",
            f"{PLAIN} -o deep/er/new.zarr",
        ),
        "a gamma for linear light": (
            "relight scene.zarr shown.png -o new.tiff --gamma 2.2",
            "gamma",
            RELIGHT,
        ),
        "an export to T.NPZ": (
            "export scene.zarr new/T.NPZ --exposure",
            "such option",
            "export scene.zarr T2.npz",
        ),
        "a pattern of another size": (
            "relight scene.zarr black8.png -o deep/new.png",
            "black8.png|size|shape|no such file",
            "relight scene.zarr shown.png -o deep/new.png",
        ),
        "a wanted picture of another size": (
            "compensate scene.zarr wide.npy -o new.png",
            "wide.npy has shape",
            COMPENSATE,
        ),
        "a wanted picture that is all black": (
            "compensate scene.zarr dark.npy -o new.png --resize",
            "dark.npy is all black",
            COMPENSATE,
        ),
        "a mask that leaves nothing": (
            "compensate scene.zarr shown.png --resize --mask none.npy -o new.png",
            "none.npy leaves no camera pixel",
            COMPENSATE,
        ),
        "patterns of an unknown kind": ("patterns noise -o new", "noise", PATTERNS),
    }
    cases = []
    pictures = both(
        array("wide.npy", np.ones((3, 5), np.float32)),
        array("dark.npy", np.zeros((4, 4), np.float32)),
        array("none.npy", np.zeros(SHAPE, np.float32)),
    )
    for name, (command, words, then) in wrong.items():
        prepare = pictures if command.startswith("compensate") else nothing
        cases.append(Case(f"{name}, then the right command", command, words, prepare, then=then))
    return cases


def _odd_but_fine() -> list[Case]:
    line = f"{PLAIN} -o new.zarr"
    return [
        Case("an export to T.NPZ", "export scene.zarr T.NPZ", code=0, check=holds("T.NPZ")),
        Case("an export to T.MAT", "export scene.zarr T.MAT", code=0, check=holds("T.MAT")),
        Case(
            "a truth called T.NPZ",
            "evaluate scene.zarr --truth T.NPZ",
            (),
            move("T.npz", "T.NPZ"),
            code=0,
        ),
        Case(
            "a simulation of T.NPZ",
            "simulate T.NPZ --patterns patterns -o new",
            (),
            move("T.npz", "T.NPZ"),
            code=0,
        ),
        Case("a plan of T.NPZ", "plan T.NPZ --size 8x8", (), move("T.npz", "T.NPZ"), code=0),
        Case(
            "a relit b.PNG takes its gamma",
            f"{RELIGHT.replace('new.png', 'b.PNG')} --gamma 2.2",
            code=0,
            check=_same_as_lower_case,
        ),
        Case("a seed of 2^64 - 1", f"{PATTERNS} --seed 18446744073709551615", code=(0, 2)),
        Case(
            "an output called :smile:",
            f"{PATTERNS.replace('new', ':smile:')}",
            code=0,
            check=every(holds(":smile:/pattern_0000.png"), prints(":smile:")),
        ),
        Case(
            "an output called [red]",
            f"{PATTERNS.replace('new', '[red]')}",
            code=0,
            check=prints("[red]"),
        ),
        Case(
            "an output called [/red]",
            "export scene.zarr '[/red].npz'",
            code=0,
            check=prints("[/red].npz"),
        ),
        Case(
            "an output whose name is not UTF-8",
            "patterns bernoulli -k 2 --size 8x8 -o 'caf\udce9'",
            code=0,
        ),
        Case(
            "an output with a line break in its name",
            "patterns bernoulli -k 2 --size 8x8 -o 'a\nb'",
            code=0,
        ),
        Case(
            "a picture x[/y].png relit",
            "relight scene.zarr 'x[/y].png' -o 'out[/z].png'",
            (),
            copy("shown.png", "x[/y].png"),
            code=0,
            check=prints("out[/z].png"),
        ),
        Case(
            "a broken picture x[/y].png",
            "relight scene.zarr 'x[/y].png' -o new.png",
            "x[/y].png",
            text("x[/y].png"),
        ),
        Case("a missing x[/y].png planned from", "plan 'x[/y].png' --size 8x8", "x[/y].png"),
        Case(
            "a store called [b].zarr is named",
            "info '[b].zarr'",
            (),
            copy("scene.zarr", "[b].zarr"),
            code=0,
            check=prints("[b].zarr"),
        ),
        Case(
            "a store called :b:.zarr is named",
            "info :boom:.zarr",
            (),
            copy("scene.zarr", ":boom:.zarr"),
            code=0,
            check=prints(":boom:.zarr"),
        ),
        Case(
            "an estimate into [/s].zarr",
            line.replace("new.zarr", "'[/s].zarr'"),
            code=0,
            check=prints("[/s].zarr"),
        ),
        Case(
            "an error with markup in an option",
            "patterns bernoulli --size '[/bold]' -o new",
            "[/bold]",
        ),
    ]


def _same_as_lower_case(folder: object, ran: object) -> str | None:
    from pathlib import Path

    from ..zygote import run_command

    place = Path(str(folder))
    run_command(f"{RELIGHT} --gamma 2.2", place)
    same = (place / "new.png").read_bytes() == (place / "b.PNG").read_bytes()
    return None if same else "b.PNG is not what new.png is"


def _names() -> list[Case]:
    long = "a" * 300
    return [
        Case("no words at all for estimate", "estimate", "no capture is given"),
        Case("an unknown command", "photograph", "photograph"),
        Case("an unknown option", f"{PATTERNS} --shade red", "--shade"),
        Case(
            "a name of 300 letters for an output",
            f"patterns bernoulli -k 2 --size 8x8 -o {long}",
            "aaa",
        ),
        Case("a name of 300 letters for a capture", f"estimate {long} -o new.zarr", "aaa"),
        Case("a name of 300 letters for a store", f"info {long}.zarr", "aaa"),
        Case(
            "a name of 300 letters for a truth",
            f"simulate {long}.npz --patterns patterns -o new",
            "aaa",
        ),
        Case(
            "a name of 300 letters for a picture",
            f"relight scene.zarr {long}.png -o new.png",
            "aaa",
        ),
        Case("a name of 300 letters for a curve", f"{FOLDERS} --response curve:{long}", "aaa"),
        Case("a name with a null byte", "info 'a\0b.zarr'", "zarr|null"),
        Case("a path below a file", "info holiday.jpg/scene.zarr", "scene.zarr"),
        Case(
            "an output below a file", "patterns bernoulli -k 2 --size 8x8 -o holiday.jpg/new", "new"
        ),
        Case(
            "an output below a link to itself",
            "patterns bernoulli -k 2 --size 8x8 -o loop/new",
            "new|loop",
            link("loop", "loop"),
        ),
        Case(
            "a store that is a link to itself",
            "info loop.zarr",
            "loop.zarr",
            link("loop.zarr", "loop.zarr"),
        ),
        Case(
            "a truth that is a link to itself",
            "simulate loop.npz --patterns patterns -o new",
            "loop.npz",
            link("loop.npz", "loop.npz"),
        ),
        Case(
            "a capture that is a link to itself",
            "estimate loop -o new.zarr",
            "loop",
            link("loop", "loop"),
        ),
        Case(
            "more patterns than bits can tell",
            "patterns hadamard -k 5000 --size 8x8 -o new",
            "5000|pattern",
        ),
        Case(
            "both a capture and folders", "estimate capture --images photos -o new.zarr", "--images"
        ),
        Case(
            "frames and patterns that differ in number",
            "estimate --patterns projected --images photos -o new.zarr",
            "31 images",
            remove("photos/image_0003.png"),
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
        "photos",
        "projected",
        "black.png",
        "holiday.jpg",
        "shown.png",
        "white.png",
    ),
)

CASES = [*_refused(), *_first_wrong_then_right(), *_odd_but_fine(), *_names()]
