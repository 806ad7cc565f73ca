"""Runs that were interrupted, and what lies about of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from .case import Case, Prepare, bear
from .checks import holds, if_accepted, same_matrix, says_not
from .put import DEEP, both, flip, folder_at, link, pipe, remove, text
from .run import Limits, Ran, SkipError, run
from .work import TILED

NEEDS = ("capture", "dense.zarr")
AGAIN = f"{TILED} -o new.zarr"
COHERENT = "estimate capture --coherent --no-check --correct none --tile-rows 16 -o new.zarr"
PARTIAL = "new.zarr.partial"
MADE = ("new.zarr", PARTIAL)


# What an interrupted run leaves, by name: the same for every case, made once in a process.
_KEPT: dict[str, bytes] = {}


def interrupted(folder: Path) -> None:
    """An estimate that fails when it joins its tiles: the disk takes these, but not the whole."""
    place = folder / PARTIAL
    for size in () if _KEPT else (9000, 7000, 8000, 11000, 13000):
        ran = run(AGAIN, folder, Limits(file_size=size))
        if len(list(place.glob("rows-*.npz"))) == 8:
            _KEPT.update({file.name: file.read_bytes() for file in place.iterdir()})
            return
        if ran.code == 0:
            remove("new.zarr")(folder)
    if not _KEPT:
        raise SkipError("no limit leaves finished tiles behind")
    place.mkdir()
    for name, content in _KEPT.items():
        (place / name).write_bytes(content)


def _at(pattern: str, put: Callable[[str], Prepare]) -> Prepare:
    """A fault in what an interrupted run leaves: in the second file of a pattern, or the only."""

    def fault(folder: Path) -> None:
        interrupted(folder)
        file = sorted((folder / PARTIAL).glob(pattern))[:2][-1]
        put(str(file.relative_to(folder)))(folder)

    return fault


def _tile(put: Callable[[str], Prepare]) -> Prepare:
    return _at("rows-*.npz", put)


def _tiles() -> list[Case]:
    puts: dict[str, Prepare] = {
        "as it was left": interrupted,
        "a tile with a flipped bit": _tile(lambda name: flip(name, 0.3, 4)),
        "a tile that is a folder": _tile(folder_at),
        "a tile that is a pipe": _tile(pipe),
        "a tile that is a link to nowhere": _tile(lambda name: link(name, "gone.npz")),
    }
    # What is no file at all may be left to the user, if it is named.
    refusable = ("a tile that is a folder", "a tile that is a pipe", "a tile that is a link")
    # A resumed run must give what an undisturbed one gives, bit for bit.
    same = if_accepted(same_matrix("new.zarr", "dense.zarr"))
    return [
        Case(
            name,
            AGAIN,
            (),
            put,
            code=(0, 2) if name.startswith(refusable) else 0,
            makes=MADE,
            check=same,
        )
        for name, put in puts.items()
    ]


def _headers() -> list[Case]:
    # Without a sound fingerprint nobody knows whose tiles these are: refused, and with
    # --overwrite begun anew. What is kept, either way, is the user's choice.
    puts: dict[str, Callable[[str], Prepare]] = {
        "nested 100,000 deep": lambda name: text(name, DEEP),
        "that is a pipe": pipe,
        "that is missing": remove,
        "that is a link to nowhere": lambda name: link(name, "gone.json"),
    }
    other = f"{AGAIN} --regularization 0.5"
    foreign = f"{PARTIAL}/photo.jpg"
    return [
        *(
            Case(
                f"a fingerprint {words}",
                AGAIN,
                "",
                _at("*.json", put),
                code=(0, 2),
                leaves=(PARTIAL,),
                makes=MADE,
            )
            for words, put in puts.items()
        ),
        Case("tiles of other settings", other, (PARTIAL, "--overwrite"), interrupted),
        Case(
            "tiles of other settings, thrown away",
            f"{other} --overwrite",
            (),
            interrupted,
            code=0,
            makes=MADE,
        ),
        Case(
            "a foreign file among the tiles",
            AGAIN,
            (),
            both(interrupted, text(foreign)),
            code=(0, 2),
            makes=MADE,
            check=holds(foreign),
        ),
        Case("info of an incomplete estimate", "info new.zarr", "incomplete", interrupted),
        Case(
            "a running estimate's memory is damaged",
            COHERENT,
            (),
            _memory,
            code=0,
            makes=MADE,
            check=same_matrix("new.zarr", "wanted.zarr"),
        ),
        Case(
            "a full disk says what is kept",
            AGAIN,
            "new.zarr",
            limits=Limits(file_size=9000),
            leaves=(PARTIAL,),
            check=_honest,
        ),
    ]


def _memory(folder: Path) -> None:
    run(COHERENT.replace("new.zarr", "wanted.zarr"), folder)
    for size in (1500, 2000, 2600, 3400, 4400, 6000, 9000, 14000):
        ran = run(COHERENT, folder, Limits(file_size=size))
        held = list((folder / PARTIAL).glob("*.npz")) if ran.code else []
        if held:
            for file in held:
                flip(str(file.relative_to(folder)), 0.4, 2)(folder)
            return
    raise SkipError("no limit leaves anything behind")


def _honest(folder: Path, ran: Ran) -> str | None:
    denied = says_not("nothing was left behind", "nothing is left behind")
    return denied(folder, ran) if (folder / PARTIAL).exists() else None


CASES = [*_tiles(), *_headers()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_partial(case: Case, work: Path) -> None:
    bear(case, work)
