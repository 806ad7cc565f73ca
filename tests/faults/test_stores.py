"""Damaged stores."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from .case import Case, Prepare, bear
from .checks import prints
from .put import (
    attribute,
    both,
    copy,
    folder_at,
    json_edit,
    link,
    pipe,
    remove,
    stored,
    text,
    with_item,
)

NEEDS = ("T.npz", "scene.zarr", "shown.png")
# What reads a store. Any of these crashed on some damaged one.
READERS = {
    "info": "info bad.zarr",
    "relight": "relight bad.zarr shown.png -o out.npy",
    "export npz": "export bad.zarr out.npz",
    "export mat": "export bad.zarr out.mat",
    "export whole": "export bad.zarr out.npz --dense-background",
    "evaluate": "evaluate bad.zarr --truth T.npz",
}
INFO = READERS["info"]
HEADER, INNER = "bad.zarr/zarr.json", "bad.zarr/data/zarr.json"
OUT = ("out.npy", "out.npz", "out.mat")


def _bad(*puts: Prepare) -> Prepare:
    """A copy of a sound store with faults put into it."""
    return both(copy("scene.zarr", "bad.zarr"), *puts)


def _parts() -> list[Case]:
    """tests/transport/test_untrusted_matrices.py has all arrays and attributes that are refused."""
    index = _bad(stored("bad.zarr", "indices", with_item(5, 64)))
    half = _bad(attribute("bad.zarr", "provenance", {"estimator": "half \ud800 of a sign"}))
    markup = {"estimator": "[/red]", "solver": "[bold", "scene": ":smile:"}
    odd = ({"versions": "text"}, {"solver_parameters": "text"}, {"solver": ["a"]})
    return [
        # Damage that only one reader minds is tried with every one.
        *(
            Case(f"an index of N: {reader}", line, "bad.zarr", index, makes=OUT)
            for reader, line in READERS.items()
        ),
        *(
            Case(f"provenance that is no text: {line}", line, (), half, code=0, makes=OUT)
            for line in (INFO, f"{INFO} --json", READERS["export mat"])
        ),
        *(
            Case(
                f"provenance of {value}",
                INFO,
                (),
                _bad(attribute("bad.zarr", "provenance", value)),
                code=(0, 2),
            )
            for value in odd
        ),
        Case(
            "provenance of markup",
            f"{INFO} --verbose",
            (),
            _bad(attribute("bad.zarr", "provenance", {**markup, "versions": {"[x]": "["}})),
            code=0,
            check=prints("[/red]", ":smile:"),
        ),
    ]


def _header() -> list[Case]:
    """tests/transport/test_untrusted_matrices.py damages headers and chunks of all kinds."""
    faults: dict[str, Prepare] = {
        "zarr.json is a folder": _bad(folder_at(HEADER)),
        "zarr.json is missing": _bad(remove(HEADER)),
        "an array is missing": _bad(remove("bad.zarr/indices")),
        "a store that is a pipe": pipe("bad.zarr"),
        "a store that is a file": text("bad.zarr"),
        "a store that is a link to nowhere": link("bad.zarr", "gone.zarr"),
    }
    lost = _bad(remove("bad.zarr/diagnostics"))
    return [
        *(Case(words, INFO, "bad.zarr", put) for words, put in faults.items()),
        Case("diagnostics are missing", INFO, (), lost, code=(0, 2)),
        Case("a store by a link", INFO, (), link("bad.zarr", "scene.zarr"), code=0),
        Case("a store that is a capture", "info capture", "capture"),
    ]


def _chunk_of(folder: Path, array: str) -> str:
    files = [f for f in (folder / "bad.zarr" / array).rglob("*") if f.is_file()]
    return str(next(f for f in files if f.name != "zarr.json").relative_to(folder))


def _foreign_parts() -> list[Case]:
    """Parts that are sound in themselves but were not written together."""

    def indices_over_data(folder: Path) -> None:
        _bad()(folder)
        shutil.copyfile(folder / _chunk_of(folder, "indices"), folder / _chunk_of(folder, "data"))

    def turned(held: dict[str, Any]) -> None:
        rows, cols = held["attributes"]["camera_shape"]
        held["attributes"]["camera_shape"] = [rows * 2, cols // 2]

    as_integers = json_edit(INNER, lambda held: held.update(data_type="uint32"))
    unsealed = json_edit(HEADER, lambda held: held["attributes"].pop("digest"))
    faults: dict[str, tuple[Prepare, tuple[str, ...]]] = {
        "the indices as data": (indices_over_data, ("bad.zarr", "data/c/0")),
        "data read as whole numbers": (_bad(as_integers), ("bad.zarr", "together")),
        "a camera of another shape": (_bad(json_edit(HEADER, turned)), ("bad.zarr",)),
        "no digest": (_bad(unsealed), ("bad.zarr", "digest")),
    }
    return [
        Case(f"{words}: {reader}", READERS[reader], says, put)
        for words, (put, says) in faults.items()
        for reader in ("info", "relight")
    ]


def _old_format(folder: Path) -> None:
    """A store of format 2 whose objects are pickles that would leave a file `pwned`."""
    _bad()(folder)
    attributes = json.loads((folder / HEADER).read_text())["attributes"]
    array = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "compressor": None}
    array |= {"fill_value": None, "order": "C", "filters": [{"id": "pickle", "protocol": 0}]}
    metadata = {".zgroup": {"zarr_format": 2}, ".zattrs": attributes}
    for name in ("data", "indices", "indptr", "background"):
        metadata[f"{name}/.zarray"] = array
        text(f"bad.zarr/{name}/0", b"cos\nsystem\n(S'touch pwned'\ntR.")(folder)
    for name, content in metadata.items():
        text(f"bad.zarr/{name}", json.dumps(content))(folder)
    whole = {"zarr_consolidated_format": 1, "metadata": metadata}
    text("bad.zarr/.zmetadata", json.dumps(whole))(folder)


CASES = [
    *_parts(),
    *_header(),
    *_foreign_parts(),
    Case("a store of format 2 beside the third", INFO, (), _old_format, code=(0, 2)),
    Case("a store of format 2 with pickles", INFO, "bad.zarr", both(_old_format, remove(HEADER))),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_stores(case: Case, work: Path) -> None:
    bear(case, work)
