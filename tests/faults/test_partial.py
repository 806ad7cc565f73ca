"""D1 and C: runs that were interrupted, and what lies about of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..case import Case, Limits, Prepare, Ran, SkipError
from ..checks import every, holds, if_accepted, same_matrix, says_not
from ..put import DEEP, both, cut, flip, folder_at, link, pipe, remove, text, with_item
from ..work import TILED
from ..zygote import run_command

AGAIN = f"{TILED} -o new.zarr"
COHERENT = "estimate capture --tile-rows 16 -o new.zarr"
PARTIAL = "new.zarr.partial"


def interrupted(folder: Path, command: str = AGAIN) -> None:
    """An estimate that fails when it joins its tiles: the disk takes these, but not the whole."""
    for size in (9000, 7000, 8000, 11000, 13000):
        ran = run_command(command, folder, limits=Limits(file_size=size))
        if len(tiles(folder)) == 8:
            return
        if ran.code == 0:
            remove("new.zarr")(folder)
    raise SkipError("no limit leaves finished tiles behind")


def tiles(folder: Path) -> list[Path]:
    """The files of finished tiles."""
    return sorted((folder / PARTIAL).glob("rows-*.npz"))


def _tile(put: Callable[[str], Prepare], number: int = 1) -> Prepare:
    """A fault put into a finished tile."""

    def fault(folder: Path) -> None:
        interrupted(folder)
        put(str(tiles(folder)[number].relative_to(folder)))(folder)

    return fault


def _in_tile(**changed: Any) -> Prepare:
    def put(name: str) -> Prepare:
        def fault(folder: Path) -> None:
            with np.load(folder / name) as held:
                content = {key: held[key] for key in held.files}
            for key, change in changed.items():
                if change is None:
                    content.pop(key)
                else:
                    content[key] = change(content[key])
            np.savez(folder / name, **content)

        return fault

    return _tile(put)


def _case(name: str, put: Prepare, **more: Any) -> Case:
    """A resumed run must give what an undisturbed one gives, bit for bit."""
    return Case(
        name,
        AGAIN,
        (),
        put,
        **{
            "code": 0,
            "makes": ("new.zarr", PARTIAL),
            "check": same_matrix("new.zarr", "dense.zarr"),
            **more,
        },
    )


def _rename(target: str) -> Callable[[str], Prepare]:
    def put(name: str) -> Prepare:
        return lambda folder: (folder / name).rename(folder / PARTIAL / target)

    return put


def _tiles() -> list[Case]:
    puts: dict[str, Prepare] = {
        "as it was left": interrupted,
        "a tile cut off": _tile(lambda name: cut(name, 300)),
        "a tile without its last bytes": _tile(lambda name: cut(name, 1000)),
        "a tile of 0 bytes": _tile(lambda name: cut(name, 0)),
        "a tile with a flipped bit": _tile(lambda name: flip(name, 0.3, 4)),
        "a tile with a flipped bit near its end": _tile(lambda name: flip(name, 0.93, 1)),
        "a tile of text": _tile(text),
        "a tile that is a folder": _tile(folder_at),
        "a tile that is a pipe": _tile(pipe),
        "a tile that is a link to nowhere": _tile(lambda name: link(name, "gone.npz")),
        "a tile that is missing": _tile(remove),
        "a tile with an index of N": _in_tile(indices=with_item(2, 64)),
        "a tile with an index below 0": _in_tile(indices=with_item(2, -1)),
        "a tile with row ends that go down": _in_tile(indptr=with_item(3, 10**6)),
        "a tile with row ends below 0": _in_tile(indptr=with_item(1, -7)),
        "a tile with row ends too few": _in_tile(indptr=lambda held: held[:-2]),
        "a tile with nan": _in_tile(data=with_item(2, np.nan)),
        "a tile with infinity": _in_tile(background=with_item(2, np.inf)),
        "a tile without values": _in_tile(data=None),
        "a tile without a background": _in_tile(background=None),
        "a tile of another shape": _in_tile(shape=lambda held: held + 1),
        "a tile of no shape": _in_tile(shape=lambda held: np.array(5)),
        "a tile of another background": _in_tile(background=lambda held: held[:-1]),
        "a tile of text values": _in_tile(data=lambda held: held.astype(str)),
        "a tile called rows-a-b": _tile(_rename("rows-a-b.npz")),
        "a tile called rows": _tile(_rename("rows-.npz")),
        "a tile called for other rows": _tile(_rename("rows-16-32.npz")),
        "a tile called for rows beyond the last": _tile(_rename("rows-64-72.npz")),
        "a tile called for rows below 0": _tile(_rename("rows--8-0.npz")),
    }
    # What is no file at all may be left to the user, if it is named.
    refusable = ("a tile that is a folder", "a tile that is a pipe", "a tile that is a link")
    return [
        _case(name, put)
        if not name.startswith(refusable)
        else _case(name, put, code=(0, 2), check=if_accepted(same_matrix("new.zarr", "dense.zarr")))
        for name, put in puts.items()
    ]


def _headers() -> list[Case]:
    def fingerprint(put: Callable[[str], Prepare]) -> Prepare:
        def fault(folder: Path) -> None:
            interrupted(folder)
            file = next((folder / PARTIAL).glob("*.json"))
            put(str(file.relative_to(folder)))(folder)

        return fault

    # Without a sound fingerprint nobody knows whose tiles these are: refused, and with
    # --overwrite begun anew. What is kept, either way, is the user's choice.
    puts = {
        "nested 100,000 deep": lambda name: text(name, DEEP),
        "of a list": lambda name: text(name, "[1]"),
        "of null": lambda name: text(name, "null"),
        "of 0 bytes": lambda name: text(name, ""),
        "that is a pipe": pipe,
        "that is a folder": folder_at,
        "that is missing": remove,
        "that is a link to nowhere": lambda name: link(name, "gone.json"),
    }
    cases = []
    for words, put in puts.items():
        cases.append(
            Case(
                f"a fingerprint {words}",
                AGAIN,
                "",
                fingerprint(put),
                code=(0, 2),
                leaves=(PARTIAL,),
                makes=("new.zarr", PARTIAL),
            )
        )
    return [
        *cases,
        Case(
            "tiles of other settings",
            f"{AGAIN} --regularization 0.5",
            ("new.zarr.partial", "--overwrite"),
            interrupted,
        ),
        Case(
            "tiles of other settings, thrown away",
            f"{AGAIN} --regularization 0.5 --overwrite",
            (),
            interrupted,
            code=0,
            makes=("new.zarr", PARTIAL),
        ),
        Case(
            "a foreign file among the tiles",
            AGAIN,
            (),
            both(interrupted, text(f"{PARTIAL}/photo.jpg")),
            code=(0, 2),
            makes=("new.zarr", PARTIAL),
            check=holds(f"{PARTIAL}/photo.jpg"),
        ),
        Case("info of an incomplete estimate", "info new.zarr", "incomplete", interrupted),
        Case(
            "a running estimate's memory is damaged",
            COHERENT,
            (),
            _memory,
            code=0,
            makes=("new.zarr", PARTIAL),
            check=same_matrix("new.zarr", "wanted.zarr"),
        ),
        Case(
            "a full disk says what is kept",
            AGAIN,
            "new.zarr",
            lambda folder: None,
            limits=Limits(file_size=9000),
            leaves=(PARTIAL,),
            check=_honest,
        ),
    ]


def _memory(folder: Path) -> None:
    run_command(COHERENT.replace("new.zarr", "wanted.zarr"), folder)
    for size in (1500, 2000, 2600, 3400, 4400, 6000, 9000, 14000):
        ran = run_command(COHERENT, folder, limits=Limits(file_size=size))
        held = list((folder / PARTIAL).glob("*.npz")) if ran.code else []
        if held:
            for file in held:
                flip(str(file.relative_to(folder)), 0.4, 2)(folder)
            return
    raise SkipError("no limit leaves anything behind")


def _honest(folder: Path, ran: Ran) -> str | None:
    if not (folder / PARTIAL).exists():
        return None
    return every(says_not("nothing was left behind"), says_not("nothing is left behind"))(
        folder, ran
    )


# What its cases need of the work folder.
NEEDS = ("capture", "dense.zarr")

CASES = [*_tiles(), *_headers()]
