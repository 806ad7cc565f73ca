"""Damaged matrices made whole again from their capture: byte for byte what they were."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.cli import main
from lightmatrix.errors import InputError, OutputError
from lightmatrix.files import zarr_arrays
from lightmatrix.outputs.kinds import STORE
from lightmatrix.outputs.locks import locked
from lightmatrix.store import zarr_file

PLAIN = lm.AutoEstimator(coherent=False, tile_rows=100)
COHERENT = lm.AutoEstimator(coherent=True)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> lm.Capture:
    folder = tmp_path_factory.mktemp("capture") / "capture.zarr"
    scene = lm.ProceduralScene((20, 18), (20, 20))
    lm.simulate_procedural(folder, scene, lm.BernoulliPatterns((20, 20), 16))
    return lm.Capture.open(folder)


@pytest.fixture(autouse=True)
def _small_chunks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zarr_arrays, "CHUNK", 128)
        patch.setattr("lightmatrix.estimators.repair._TOGETHER", 64)
        yield


@pytest.fixture
def stored(capture: lm.Capture, tmp_path: Path) -> Path:
    PLAIN.estimate(capture, checkpoint=tmp_path / "s.zarr")
    return tmp_path / "s.zarr"


def content(folder: Path) -> dict[str, bytes]:
    files = (entry for entry in folder.rglob("*") if entry.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def flip(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 16
    file.write_bytes(data)


def halve(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


@pytest.mark.parametrize(
    ("damage", "chunks"),
    [
        (flip, ["data/c/1"]),
        (halve, ["indices/c/0"]),
        (Path.unlink, ["indptr/c/1"]),
        (Path.unlink, ["background/c/2/0", "diagnostics/gap/c/0"]),
        (flip, ["data/c/0", "indptr/c/0", "indptr/c/1", "diagnostics/iterations/c/2"]),
    ],
)
def test_what_was_damaged_is_what_it_was(
    stored: Path, capture: lm.Capture, damage: Callable[[Path], Any], chunks: list[str]
) -> None:
    before = content(stored)
    for chunk in chunks:
        damage(stored / chunk)
    with pytest.raises(InputError, match=r"damaged[\s\S]*--repair"):
        lm.open(stored)
    done = lm.repair(stored, capture, estimator=PLAIN)
    assert sorted(done.chunks) == sorted(chunks)
    assert 0 < done.rows <= capture.rows
    assert content(stored) == before
    assert os.listdir(stored.parent) == ["s.zarr"]
    assert STORE.check_replaceable(stored, stored)


def test_only_the_rows_of_a_chunk_are_solved(stored: Path, capture: lm.Capture) -> None:
    halve(stored / "diagnostics/gap/c/2")
    told = list[int]()
    done = lm.repair(
        stored, capture, estimator=PLAIN, progress=lambda done, total: told.append(done)
    )
    # Of 128 rows a chunk the last one has 104, in two tiles of at most 72.
    assert done.rows == 144
    assert min(told) > 200
    assert lm.repair(stored, capture, estimator=PLAIN) == lm.Repair((), 0)


def test_coherent_estimates_go_through_their_rounds_again(
    capture: lm.Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "s.zarr"
    COHERENT.estimate(capture, checkpoint=output)
    before = content(output)
    flip(output / "data/c/1")
    folder = str(capture.frames.array.place.parent)  # type: ignore[attr-defined]
    assert main(["estimate", folder, "-o", str(output), "--repair", "--no-check"]) == 0
    assert "whole again" in capsys.readouterr().out
    assert content(output) == before
    assert os.listdir(tmp_path) == ["s.zarr"]


def test_other_settings_and_other_captures_change_nothing(
    stored: Path, capture: lm.Capture
) -> None:
    flip(stored / "data/c/1")
    before = content(stored)
    with pytest.raises(InputError, match=r"other settings \(.*solver_parameters"):
        lm.repair(stored, capture, estimator=lm.AutoEstimator(coherent=False, iterations=3))
    frames = np.stack([capture.frame(k) for k in range(capture.count)])
    darker = replace(capture, frames=ArrayStack(frames - (frames > 100)))
    used = zarr_file.look(stored).provenance["regularization"]
    other = lm.AutoEstimator(coherent=False, regularization=used)
    with pytest.raises(InputError, match="are not those that are stored"):
        lm.repair(stored, darker, estimator=other)
    assert content(stored) == before
    assert os.listdir(stored.parent) == ["s.zarr"]
    with locked(stored), pytest.raises(OutputError, match="is being written"):
        _in_a_thread(lambda: lm.repair(stored, capture, estimator=PLAIN))


def _in_a_thread(work: Callable[[], Any]) -> None:
    with ThreadPoolExecutor(1) as pool:
        pool.submit(work).result()


def test_files_that_were_written_again_are_listed_with_their_sizes(stored: Path) -> None:
    """Another version of the compression may give others."""
    chunk = stored / "data/c/0"
    chunk.write_bytes(chunk.read_bytes() + b"...")
    with pytest.raises(OutputError, match="changed since"):
        STORE.check_replaceable(stored, stored)
    STORE.resize(stored, {"data/c/0": chunk.stat().st_size, "not/ours": 3})
    assert STORE.check_replaceable(stored, stored)


@pytest.mark.parametrize("what", ["zarr.json", "data/zarr.json"])
def test_a_store_that_does_not_say_what_it_is(stored: Path, capture: lm.Capture, what: str) -> None:
    halve(stored / what)
    with pytest.raises(InputError):
        lm.repair(stored, capture, estimator=PLAIN)
