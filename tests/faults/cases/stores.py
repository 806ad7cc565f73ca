"""Damaged stores."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from ..case import Case, Prepare
from ..checks import every, prints, same_matrix, within
from ..put import (
    DEEP,
    attribute,
    both,
    copy,
    cut,
    flip,
    folder_at,
    json_edit,
    link,
    pipe,
    remove,
    stored,
    text,
    with_item,
)

# What reads a store. Any of these crashed on some damaged one.
READERS = {
    "info": "info bad.zarr",
    "relight": "relight bad.zarr shown.png -o out.npy",
    "export npz": "export bad.zarr out.npz",
    "export mat": "export bad.zarr out.mat",
    "export whole": "export bad.zarr out.npz --dense-background",
    "evaluate": "evaluate bad.zarr --truth T.npz",
}
BAD = copy("scene.zarr", "bad.zarr")


# CSR sums what stands twice, so that this may be read.
ALLOWED = ("an index twice in a row",)


def _arrays() -> list[Case]:
    faults: dict[str, tuple[str, Any]] = {
        "an index of N": ("indices", with_item(5, 64)),
        "an index far out": ("indices", with_item(5, 2**31 - 1)),
        "an index below 0": ("indices", with_item(5, -1)),
        "an index far below 0": ("indices", with_item(5, -(2**31))),
        "one index too few": ("indices", lambda held: held[:-1]),
        "indices of float": ("indices", lambda held: held.astype(np.float64)),
        "indices of two dimensions": ("indices", lambda held: held.reshape(1, -1)),
        "an index twice in a row": ("indices", lambda held: np.repeat(held[::2], 2)[: len(held)]),
        "row ends that go down": ("indptr", with_item(3, 10**6)),
        "row ends below 0": ("indptr", with_item(3, -5)),
        "row ends far out": ("indptr", with_item(-1, 2**40)),
        "row ends that begin late": ("indptr", with_item(0, 2)),
        "one row end too few": ("indptr", lambda held: held[:-1]),
        "one row end too many": ("indptr", lambda held: np.append(held, held[-1])),
        "row ends of int32": ("indptr", lambda held: held.astype(np.int32) - 1),
        "nan in data": ("data", with_item(7, np.nan)),
        "infinity in data": ("data", with_item(7, np.inf)),
        "one value too few": ("data", lambda held: held[:-1]),
        "data of complex numbers": ("data", lambda held: held.astype(np.complex64)),
        "data of truth values": ("data", lambda held: held > 0),
        "data of 1e300": ("data", lambda held: held.astype(np.float64) * 1e300),
        "nan in the background": ("background", with_item(7, np.nan)),
        "infinity in the background": ("background", with_item(7, -np.inf)),
        "a background of other rows": ("background", lambda held: held[:-1]),
        "a background of other blocks": ("background", lambda held: held[:, :-1]),
        "a background of one dimension": ("background", lambda held: held.ravel()),
        "diagnostics of other rows": ("diagnostics/gap", lambda held: held[:-1]),
        "diagnostics without a dimension": ("diagnostics/gap", lambda held: held[0].reshape(())),
    }
    cases = []
    for words, (name, change) in faults.items():
        put = both(BAD, stored("bad.zarr", name, change))
        # Damage that only one reader minds is tried with every one, most with two.
        readers = READERS if words.startswith(("an index", "row ends")) else ("info", "relight")
        cases += [
            Case(
                f"{words}: {reader}",
                READERS[reader],
                "" if words in ALLOWED else "bad.zarr",
                put,
                code=(0, 2) if words in ALLOWED else 2,
                makes=("out.npy", "out.npz", "out.mat"),
            )
            for reader in readers
        ]
    return cases


def _attributes() -> list[Case]:
    values: dict[str, tuple[Any, ...]] = {
        "camera_shape": (
            [8, 9],
            [0, 0],
            [-8, -8],
            [2**40, 2**40],
            "8x8",
            [8.5, 8],
            None,
            [],
            [[8]],
            [64],
            [True, 64],
        ),
        "projector_shape": ([4, 8], [0, 8], [8], [8, 8, 1], [2**62, 2], "8x8", None),
        "background_grid": ([8, 9], [0, 0], [-1, -64], [99, 99], "1x1", None, [1]),
        "version": (2, "1", None, 1.5, [1], 0, 1.0, True),
        "format": ("zarr", None, 5),
        "provenance": ("text", ["a"], 5, None),
    }
    cases = []
    for key, wrong in values.items():
        for number, value in enumerate(wrong):
            name = f"{key} is {str(value)[:24]} ({number})"
            put = both(BAD, attribute("bad.zarr", key, value))
            cases.append(Case(name, READERS["info"], "bad.zarr", put))
            if key.endswith(("shape", "grid")) and number < 4:
                cases.append(Case(f"{name}, relit", READERS["relight"], "bad.zarr", put))
    for value in (
        {"versions": "text"},
        {"versions": {"a": 5}},
        {"solver_parameters": "text"},
        {"solver": ["a"]},
        {"estimator": {"a": 1}},
    ):
        cases.append(
            Case(
                f"provenance of {value}",
                READERS["info"],
                (),
                both(BAD, attribute("bad.zarr", "provenance", value)),
                code=(0, 2),
            )
        )
    markup = {
        "estimator": "[/red]",
        "solver": "[bold",
        "scene": ":smile:",
        "versions": {"[/x]": "[y]"},
    }
    half = both(BAD, attribute("bad.zarr", "provenance", {"estimator": "half \ud800 of a sign"}))
    cases += [
        Case(f"provenance that is no text: {reader}", command, (), half, code=0,
             makes=("out.npy", "out.npz", "out.mat"))
        for reader, command in {**READERS, "info json": "info bad.zarr --json"}.items()
    ]  # fmt: skip
    cases.append(
        Case(
            "provenance of markup",
            f"{READERS['info']} --verbose",
            (),
            both(BAD, attribute("bad.zarr", "provenance", markup)),
            code=0,
            check=every(prints("[/red]"), prints(":smile:")),
        )
    )
    return cases


def _header() -> list[Case]:
    name = "bad.zarr/zarr.json"
    contents: dict[str, str | bytes] = {
        "nested 100,000 deep": DEEP,
        "of a list": "[]",
        "of null": "null",
        "empty": "",
        "of zeros": bytes(64),
        "of an array": '{"zarr_format": 3, "node_type": "array"}',
        "of a group without words": '{"zarr_format": 3, "node_type": "group"}',
        "of format 4": '{"zarr_format": 4, "node_type": "group"}',
    }
    cases = [
        Case(f"zarr.json {words}", READERS["info"], "bad.zarr", both(BAD, text(name, content)))
        for words, content in contents.items()
    ]
    inner = "bad.zarr/data/zarr.json"
    edits: dict[str, dict[str, Any]] = {
        "a shape of 10^15": {"shape": [10**15]},
        "a shape below 0": {"shape": [-5]},
        "chunks of 0": {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [0]}}},
        "an unknown type": {"data_type": "quaternion"},
        "no codecs": {"codecs": []},
        "codecs that are pickles": {"codecs": [{"name": "numcodecs.pickle", "configuration": {}}]},
        "an unknown codec": {"codecs": [{"name": "of-the-future"}]},
    }
    cases += [
        Case(
            f"an array with {words}",
            READERS["info"],
            "bad.zarr",
            both(BAD, json_edit(inner, lambda held, change=change: held.update(change))),  # type: ignore[misc]
            check=within(10),
        )
        for words, change in edits.items()
    ]
    return [
        *cases,
        Case("zarr.json is a pipe", READERS["info"], "bad.zarr", both(BAD, pipe(name))),
        Case("zarr.json is a folder", READERS["info"], "bad.zarr", both(BAD, folder_at(name))),
        Case("zarr.json is missing", READERS["info"], "bad.zarr", both(BAD, remove(name))),
        Case("an array's zarr.json is a pipe", READERS["info"], "bad.zarr", both(BAD, pipe(inner))),
        Case(
            "an array is missing",
            READERS["info"],
            "bad.zarr",
            both(BAD, remove("bad.zarr/indices")),
        ),
        Case(
            "diagnostics are missing",
            READERS["info"],
            "bad.zarr",
            both(BAD, remove("bad.zarr/diagnostics")),
            code=(0, 2),
        ),
        Case("a store that is a pipe", READERS["info"], "bad.zarr", pipe("bad.zarr")),
        Case("a store that is a file", READERS["info"], "bad.zarr", text("bad.zarr")),
        Case(
            "a store that is a link to nowhere",
            READERS["info"],
            "bad.zarr",
            link("bad.zarr", "gone.zarr"),
        ),
        Case("a store by a link", READERS["info"], (), link("bad.zarr", "scene.zarr"), code=0),
        Case("a store that is a capture", "info capture", "capture"),
    ]


def _chunk_of(folder: Path, array: str) -> str:
    files = [f for f in (folder / "bad.zarr" / array).rglob("*") if f.is_file()]
    return str(next(f for f in files if f.name != "zarr.json").relative_to(folder))


def _chunks() -> list[Case]:
    def at_chunk(array: str, put: Any) -> Prepare:
        def fault(folder: Path) -> None:
            BAD(folder)
            put(_chunk_of(folder, array))(folder)

        return fault

    cases = []
    for array in ("data", "indices", "indptr", "background"):
        damages = {
            "flipped": lambda name: flip(name, 0.5, 3),
            "cut off": lambda name: cut(name, 20),
            "empty": lambda name: cut(name, 0),
            "missing": remove,
            "of noise": lambda name: text(name, bytes(range(256))),
            "a pipe": pipe,
        }
        for words, put in damages.items():
            cases.append(
                Case(
                    f"a chunk of {array} {words}", READERS["info"], "bad.zarr", at_chunk(array, put)
                )
            )
    return cases


def _foreign_parts() -> list[Case]:
    """Parts that are sound in themselves but were not written together."""

    def other_matrix(folder: Path) -> None:
        BAD(folder)
        stored("bad.zarr", "data", lambda held: 2 * held)(folder)

    def chunk_of_another(folder: Path) -> None:
        other_matrix(folder)
        chunk = (folder / _chunk_of(folder, "data")).read_bytes()
        shutil.rmtree(folder / "bad.zarr")
        BAD(folder)
        (folder / _chunk_of(folder, "data")).write_bytes(chunk)

    def array_of_another(folder: Path) -> None:
        other_matrix(folder)
        shutil.move(folder / "bad.zarr" / "data", folder / "other")
        shutil.rmtree(folder / "bad.zarr")
        BAD(folder)
        shutil.rmtree(folder / "bad.zarr" / "data")
        shutil.move(folder / "other", folder / "bad.zarr" / "data")

    def indices_over_data(folder: Path) -> None:
        BAD(folder)
        shutil.copyfile(folder / _chunk_of(folder, "indices"), folder / _chunk_of(folder, "data"))

    def turned(held: dict[str, Any]) -> None:
        rows, cols = held["attributes"]["camera_shape"]
        held["attributes"]["camera_shape"] = [rows * 2, cols // 2]

    def unsealed(held: dict[str, Any]) -> None:
        del held["attributes"]["digest"]

    whole, inner = "bad.zarr/zarr.json", "bad.zarr/data/zarr.json"
    as_integers = json_edit(inner, lambda held: held.update(data_type="uint32"))
    faults: dict[str, tuple[Prepare, tuple[str, ...]]] = {
        "a chunk of another store": (chunk_of_another, ("bad.zarr", "data/c/0")),
        "an array of another store": (array_of_another, ("bad.zarr", "data/c/0")),
        "the indices as data": (indices_over_data, ("bad.zarr", "data/c/0")),
        "data read as whole numbers": (both(BAD, as_integers), ("bad.zarr", "together")),
        "a camera of another shape": (both(BAD, json_edit(whole, turned)), ("bad.zarr",)),
        "no digest": (both(BAD, json_edit(whole, unsealed)), ("bad.zarr", "digest")),
    }
    return [
        Case(f"{words}: {reader}", READERS[reader], says, put)
        for words, (put, says) in faults.items()
        for reader in ("info", "relight", "export npz")
    ]


def _consolidated() -> list[Case]:
    """Metadata that stands twice: only that of the arrays counts, and none of it runs code."""

    def lie(folder: Path) -> None:
        BAD(folder)
        arrays = {}
        for file in (folder / "bad.zarr").rglob("zarr.json"):
            name = str(file.parent.relative_to(folder / "bad.zarr"))
            if name != ".":
                arrays[name] = json.loads(file.read_text())
        arrays["data"]["shape"] = [3]
        consolidated = {"kind": "inline", "must_understand": False, "metadata": arrays}
        json_edit(
            "bad.zarr/zarr.json", lambda held: held.update(consolidated_metadata=consolidated)
        )(folder)

    def old_format(folder: Path) -> None:
        # A store of format 2 whose objects are pickles that would leave a file `pwned`.
        place = folder / "bad.zarr"
        BAD(folder)
        text("bad.zarr/.zgroup", '{"zarr_format": 2}')(folder)
        attributes = json.loads((place / "zarr.json").read_text())["attributes"]
        text("bad.zarr/.zattrs", json.dumps(attributes))(folder)
        array = {
            "zarr_format": 2,
            "shape": [1],
            "chunks": [1],
            "dtype": "|O",
            "compressor": None,
            "fill_value": None,
            "order": "C",
            "filters": [{"id": "pickle", "protocol": 0}],
        }
        metadata = {
            "zarr_consolidated_format": 1,
            "metadata": {".zgroup": {"zarr_format": 2}, ".zattrs": attributes},
        }
        for name in ("data", "indices", "indptr", "background"):
            metadata["metadata"][f"{name}/.zarray"] = array  # type: ignore[index]
            text(f"bad.zarr/{name}/.zarray", json.dumps(array))(folder)
            text(f"bad.zarr/{name}/0", b"cos\nsystem\n(S'touch pwned'\ntR.")(folder)
        text("bad.zarr/.zmetadata", json.dumps(metadata))(folder)

    return [
        Case(
            "consolidated metadata that lies",
            READERS["info"],
            (),
            lie,
            code=0,
            check=same_matrix("bad.zarr", "scene.zarr"),
        ),
        Case("a store of format 2 beside the third", READERS["info"], (), old_format, code=(0, 2)),
        Case(
            "a store of format 2 with pickles",
            READERS["info"],
            "bad.zarr",
            both(old_format, remove("bad.zarr/zarr.json")),
        ),
        Case(
            "a store of format 2 with pickles and an empty zarr.json",
            READERS["info"],
            "bad.zarr",
            both(old_format, text("bad.zarr/zarr.json", "{}")),
        ),
    ]


# What its cases need of the work folder.
NEEDS = ("T.npz", "scene.zarr", "shown.png")

CASES = [*_arrays(), *_attributes(), *_header(), *_chunks(), *_foreign_parts(), *_consolidated()]
