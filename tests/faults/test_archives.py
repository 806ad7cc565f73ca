"""Truth files and exports (npz) are not trusted."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .case import Case, bear
from .put import device, folder_at, link, packed, pipe, with_item
from .run import Limits

NEEDS = ("T.npz", "patterns", "scene.zarr", "plain.npz", "projected", "photos", "capture")
ROOM = Limits(memory=1 << 30)
# What reads T.npz.
READERS = {
    "simulate": "simulate T.npz --patterns patterns -o new",
    "evaluate": "evaluate scene.zarr --truth T.npz",
    "plan": "plan T.npz --size 8x8",
}


def _bomb(folder: Path) -> None:
    """An archive whose values inflate to 1.25 GiB, from a few MB."""
    with np.load(folder / "T.npz") as held:
        content = {key: held[key] for key in held.files}
    with zipfile.ZipFile(folder / "T.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        for key, value in content.items():
            with made.open(f"{key}.npy", "w", force_zip64=True) as opened:
                if key != "data":
                    np.lib.format.write_array(opened, value)
                    continue
                header = {"descr": "<f4", "fortran_order": False, "shape": (5 << 26,)}
                np.lib.format.write_array_header_1_0(opened, header)
                for _ in range(5 << 4):
                    opened.write(bytes(1 << 24))


def _pickled(folder: Path) -> None:
    with np.load(folder / "T.npz") as held:
        content: dict[str, Any] = {key: held[key] for key in held.files}
    content["metadata"] = np.array([{"a": 1}], dtype=object)
    np.savez(folder / "T.npz", **content)


def _files() -> list[Case]:
    line = READERS["simulate"]
    # tests/transport/test_untrusted_matrices.py has archives of all kinds.
    faults = {
        "of pickles": _pickled,
        "with direct parts of nan": packed("T.npz", direct_data=with_item(3, np.nan)),
        "that is a folder": folder_at("T.npz"),
        "that is a link to nowhere": link("T.npz", "gone.npz"),
    }
    below = packed("T.npz", data=lambda held: -held)
    index = packed("T.npz", indices=with_item(5, 64))
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
        *(Case(f"a pipe: {name}", r, "T.npz", pipe("T.npz")) for name, r in READERS.items()),
        *(Case(f"an index of N: {name}", r, "T.npz", index) for name, r in READERS.items()),
        # As a signed estimate has them.
        Case("values below 0", line, (), below, code=(0, 2)),
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


@pytest.mark.parametrize("case", _files(), ids=str)
def test_archives(case: Case, work: Path) -> None:
    bear(case, work)
