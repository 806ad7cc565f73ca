"""D1, D3 and D4: truth files and exports (npz) are not trusted."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..case import Case, Limits
from ..checks import within
from ..put import DEEP, both, cut, device, flip, folder_at, link, packed, pipe, text, with_item

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
    "an index below 0": {"indices": with_item(5, -1)},
    "an index far out": {"indices": with_item(5, 2**31 - 1)},
    "indices of float": {"indices": lambda held: held.astype(float) + 0.5},
    "indices of text": {"indices": lambda held: held.astype(str)},
    "indices of two dimensions": {"indices": lambda held: held.reshape(2, -1)},
    "one index too few": {"indices": lambda held: held[:-1]},
    "row ends that go down": {"indptr": with_item(3, 10**6)},
    "row ends below 0": {"indptr": with_item(3, -5)},
    "row ends too few": {"indptr": lambda held: held[:-1]},
    "row ends without a dimension": {"indptr": np.array(5)},
    "nan": {"data": with_item(7, np.nan)},
    "infinity": {"data": with_item(7, np.inf)},
    "values of 1e300": {"data": lambda held: held.astype(float) * 1e300},
    "values of complex numbers": {"data": lambda held: held * 1j},
    "values of text": {"data": lambda held: held.astype(str)},
    "values of dates": {"data": lambda held: held.astype("i8").astype("M8[s]")},
    "values without a dimension": {"data": np.array(1.0)},
    "values below 0": {"data": lambda held: -held},
    "values too few": {"data": lambda held: held[:-1]},
    "a shape without a dimension": {"shape": np.array(64)},
    "a shape of one number": {"shape": np.array([64])},
    "a shape of three": {"shape": np.array([64, 64, 1])},
    "a shape of 10^9": {"shape": BIG},
    "a shape below 0": {"shape": np.array([-64, -64])},
    "a shape of text": {"shape": np.array("64x64")},
    "a camera without a dimension": {"camera_shape": np.array(64)},
    "a camera of another size": {"camera_shape": np.array([8, 9])},
    "a camera of size 0": {"camera_shape": np.array([0, 0])},
    "a camera of none": {"camera_shape": np.array([], int)},
    "a camera of text": {"camera_shape": np.array(["8", "a"])},
    "a camera of nan": {"camera_shape": np.array([8, np.nan])},
    "a camera below 0": {"camera_shape": np.array([-8, -8])},
    "a camera whose size overflows": {"camera_shape": np.array([2**62, 4])},
    "a projector without a dimension": {"projector_shape": np.array(64)},
    "a projector of one number": {"projector_shape": np.array([64])},
    "a projector of three": {"projector_shape": np.array([8, 8, 1])},
    "a projector of another size": {"projector_shape": np.array([4, 8])},
    "direct parts without a dimension": {"direct_data": np.array(1.0)},
    "direct parts too few": {"direct_data": lambda held: held[:-1]},
    "direct parts of text": {"direct_data": lambda held: held.astype(str)},
    "direct parts of nan": {"direct_data": with_item(3, np.nan)},
    "words that are no JSON": {"metadata": np.array("{scene")},
    "words that are a list": {"metadata": np.array("[1]")},
    "words that are a number": {"metadata": np.array(5.0)},
    "words that are many": {"metadata": np.array(["{}", "{}"])},
    "words nested 100,000 deep": {"metadata": np.array(DEEP)},
    "a version of the future": {"lightmatrix_truth": np.array(99)},
    "a version of text": {"lightmatrix_truth": np.array("one")},
    "a version of many": {"lightmatrix_truth": np.array([1, 1])},
    "a format of columns": {"format": np.array(b"csc")},
    "no row ends": {"indptr": None},
    "no shapes": {"camera_shape": None, "projector_shape": None},
    "no values": {"data": None},
}


def _changes() -> list[Case]:
    cases = []
    for words, changed in CHANGES.items():
        put = packed("T.npz", **changed)
        all_readers = words.startswith(("an index", "row ends", "nan", "infinity"))
        for reader in READERS if all_readers else ("simulate",):
            possible = words == "values below 0"  # as a signed estimate has them
            cases.append(
                Case(
                    f"a truth with {words}: {reader}",
                    READERS[reader],
                    "" if possible else "T.npz",
                    put,
                    code=(0, 2) if possible else 2,
                )
            )
    return cases


def _bomb(size: int) -> Any:
    """An archive whose values inflate without end, from a few MB."""

    def fault(folder: Path) -> None:
        with np.load(folder / "T.npz") as held:
            content = {key: held[key] for key in held.files}
        with zipfile.ZipFile(folder / "T.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
            for key, value in content.items():
                with made.open(f"{key}.npy", "w", force_zip64=True) as opened:
                    if key != "data":
                        np.lib.format.write_array(opened, value)
                        continue
                    header = {"descr": "<f4", "fortran_order": False, "shape": (size // 4,)}
                    np.lib.format.write_array_header_1_0(opened, header)
                    for _ in range(size >> 24):
                        opened.write(bytes(1 << 24))

    return fault


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


def _files() -> list[Case]:
    line = READERS["simulate"]
    twice = {"data": b"", "indices": b""}
    return [
        Case("a truth of pickles", line, "T.npz", _pickled),
        Case(
            "a truth that is a bomb",
            line,
            "T.npz|memory",
            _bomb(3 << 30),
            code=(2, 3),
            limits=Limits(memory=1 << 30),
            check=within(20),
            seconds=60,
        ),
        Case("a truth with empty members", line, "T.npz", _members(**twice)),
        Case("a truth with a member of noise", line, "T.npz", _members(data=bytes(range(256)))),
        Case("a truth that is an empty archive", line, "T.npz", _members()),
        Case(
            "a truth that is one array",
            line,
            "T.npz",
            lambda folder: np.save((folder / "T.npz").open("wb"), np.eye(4)),
        ),
        Case("a truth that is a text", line, "T.npz", text("T.npz")),
        Case("a truth of 0 bytes", line, "T.npz", text("T.npz", "")),
        Case("a truth cut off", line, "T.npz", cut("T.npz", 900)),
        Case(
            "a truth with a flipped bit",
            line,
            "T.npz",
            both(packed("T.npz"), flip("T.npz", 0.4, 2)),
        ),
        Case("a truth that is a folder", line, "T.npz", folder_at("T.npz")),
        Case("a truth that is a pipe", line, "T.npz", pipe("T.npz")),
        Case("a truth that is a pipe: plan", READERS["plan"], "T.npz", pipe("T.npz")),
        Case("a truth that is a pipe: evaluate", READERS["evaluate"], "T.npz", pipe("T.npz")),
        Case(
            "a truth that is an endless device",
            line,
            "T.npz",
            device("T.npz", 5),
            limits=Limits(memory=1 << 30),
        ),
        Case("a truth that is a link to nowhere", line, "T.npz", link("T.npz", "gone.npz")),
        Case(
            "a truth with words of markup",
            line,
            (),
            packed("T.npz", metadata=np.array(json.dumps({"scene": "[/red]"}))),
            code=0,
        ),
        Case(
            "an export as a truth, with its background apart",
            "evaluate scene.zarr --truth plain.npz",
            "plain.npz",
        ),
        Case(
            "an endless device for a curve",
            "estimate --patterns projected --images photos --response curve:zero -o new.zarr",
            "zero|memory",
            device("zero", 5),
            needs=("projected", "photos"),
            code=(2, 3),
            limits=Limits(memory=1 << 30),
            check=within(15),
        ),
        Case(
            "an endless device for a white frame",
            "plan zero.png --size 8x8",
            "zero.png",
            device("zero.png", 5),
            limits=Limits(memory=1 << 30),
        ),
        Case(
            "an endless device for a pattern",
            "relight scene.zarr zero.npy -o out.npy",
            "zero.npy",
            device("zero.npy", 5),
            limits=Limits(memory=1 << 30),
        ),
        Case(
            "an endless device for capture.json",
            "estimate capture -o new.zarr",
            "capture.json",
            device("capture/capture.json", 5),
            needs=("capture",),
            limits=Limits(memory=1 << 30),
        ),
    ]


# What its cases need of the work folder.
NEEDS = ("T.npz", "patterns", "scene.zarr", "plain.npz")

CASES = [*_changes(), *_files()]
