"""Truth files and exports (npz) are not trusted."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .case import Case, bear
from .put import DEEP, both, cut, device, flip, folder_at, link, packed, pipe, text, with_item
from .run import Limits

NEEDS = ("T.npz", "patterns", "scene.zarr", "plain.npz", "projected", "photos", "capture")
ROOM = Limits(memory=1 << 30)
# What reads T.npz.
READERS = {
    "simulate": "simulate T.npz --patterns patterns -o new",
    "evaluate": "evaluate scene.zarr --truth T.npz",
    "plan": "plan T.npz --size 8x8",
}
BIG = np.array((10**9, 10**9))

# Keys changed, and what they become.
CHANGES: dict[str, dict[str, Any]] = {
    "an index of N": {"indices": with_item(5, 64)},
    "row ends that go down": {"indptr": with_item(3, 10**6)},
    "infinity": {"data": with_item(7, np.inf)},
    "values of complex numbers": {"data": lambda held: held * 1j},
    "values below 0": {"data": lambda held: -held},
    "a shape of 10^9": {"shape": BIG},
    "a camera of another size": {"camera_shape": np.array([8, 9])},
    "a camera whose size overflows": {"camera_shape": np.array([2**62, 4])},
    "direct parts of text": {"direct_data": lambda held: held.astype(str)},
    "direct parts of nan": {"direct_data": with_item(3, np.nan)},
    "words nested 100,000 deep": {"metadata": np.array(DEEP)},
    "a version of the future": {"lightmatrix_truth": np.array(99)},
    "no shapes": {"camera_shape": None, "projector_shape": None},
}


def _changes() -> list[Case]:
    cases = []
    for words, changed in CHANGES.items():
        possible = words == "values below 0"  # as a signed estimate has them
        everywhere = words == "an index of N"
        for reader in READERS if everywhere else ("simulate",):
            line, says = READERS[reader], "" if possible else "T.npz"
            code = (0, 2) if possible else (2,)
            put = packed("T.npz", **changed)
            cases.append(Case(f"a truth with {words}: {reader}", line, says, put, code=code))
    return cases


def _bomb(folder: Path) -> None:
    """An archive whose values inflate to 3 GiB, from a few MB."""
    with np.load(folder / "T.npz") as held:
        content = {key: held[key] for key in held.files}
    with zipfile.ZipFile(folder / "T.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        for key, value in content.items():
            with made.open(f"{key}.npy", "w", force_zip64=True) as opened:
                if key != "data":
                    np.lib.format.write_array(opened, value)
                    continue
                header = {"descr": "<f4", "fortran_order": False, "shape": (3 << 28,)}
                np.lib.format.write_array_header_1_0(opened, header)
                for _ in range(3 << 6):
                    opened.write(bytes(1 << 24))


def _members(**members: bytes) -> Any:
    def fault(folder: Path) -> None:
        with zipfile.ZipFile(folder / "T.npz", "w") as made:
            for name, data in members.items():
                made.writestr(f"{name}.npy", data)

    return fault


def _pickled(folder: Path) -> None:
    with np.load(folder / "T.npz") as held:
        content: dict[str, Any] = {key: held[key] for key in held.files}
    content["metadata"] = np.array([{"a": 1}], dtype=object)
    np.savez(folder / "T.npz", **content)


def _one_array(folder: Path) -> None:
    with (folder / "T.npz").open("wb") as opened:
        np.save(opened, np.eye(4))


def _files() -> list[Case]:
    line = READERS["simulate"]
    faults = {
        "of pickles": _pickled,
        "with empty members": _members(data=b"", indices=b""),
        "with a member of noise": _members(data=bytes(range(256))),
        "that is an empty archive": _members(),
        "that is one array": _one_array,
        "that is a text": text("T.npz"),
        "of 0 bytes": text("T.npz", ""),
        "cut off": cut("T.npz", 900),
        "with a flipped bit": both(packed("T.npz"), flip("T.npz", 0.4, 2)),
        "that is a folder": folder_at("T.npz"),
        "that is a pipe": pipe("T.npz"),
        "that is a link to nowhere": link("T.npz", "gone.npz"),
    }
    markup = packed("T.npz", metadata=np.array(json.dumps({"scene": "[/red]"})))
    apart = "evaluate scene.zarr --truth plain.npz"
    # What is endless is refused before the memory is full, or when it is.
    endless = {
        "T.npz": line,
        "zero": "estimate --patterns projected --images photos --response curve:zero -o new.zarr",
        "zero.png": "plan zero.png --size 8x8",
        "zero.npy": "relight scene.zarr zero.npy -o out.npy",
        "capture/capture.json": "estimate capture -o new.zarr",
    }
    return [
        *(Case(f"a truth {words}", line, "T.npz", put) for words, put in faults.items()),
        *(Case(f"a pipe: {n}", READERS[n], "T.npz", pipe("T.npz")) for n in ("plan", "evaluate")),
        *(
            Case(
                f"an endless device for {name}",
                command,
                f"{Path(name).name}: is a pipe or device",
                device(name, 5),
                limits=ROOM,
            )
            for name, command in endless.items()
        ),
        Case("a truth that is a bomb", line, "not enough memory", _bomb, code=3, limits=ROOM),
        Case("a truth with words of markup", line, (), markup, code=0),
        Case("an export as a truth, with its background apart", apart, "plain.npz"),
    ]


CASES = [*_changes(), *_files()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_archives(case: Case, work: Path) -> None:
    bear(case, work)
