"""Light transport on disk: whole or absent, the same when it comes back, no finished tile lost."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import loadmat

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.kinds import CORRESPONDENCE_MARK
from lightmatrix.transport import store
from lightmatrix.transport.checkpoint import ROWS, Checkpoint, unfinished_spans
from lightmatrix.transport.npz import export, import_npz
from tests.helpers.limits import largest_file
from tests.helpers.stores import (
    FINGERPRINT,
    TILES,
    assert_same,
    finish,
    run,
    transport,
    write_tile,
)
from tests.helpers.systems import LIMITS, SIGNALS


@pytest.mark.parametrize("camera", [(5, 4), (3, 2, 3), (1, 1)])
@pytest.mark.parametrize("density", [0.2, 0.0])
def test_a_matrix_comes_back_from_disk(
    tmp_path: Path, camera: tuple[int, ...], density: float
) -> None:
    written = transport(camera, density=density)
    store.save(tmp_path / "scene.zarr", written)
    read = store.open(tmp_path / "scene.zarr")
    assert_same(read, written)
    assert set(read.diagnostics) == {"gap", "converged"}
    for name, values in written.diagnostics.items():
        np.testing.assert_array_equal(read.diagnostics[name], values)
        assert read.diagnostics[name].dtype == values.dtype
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.zarr"]


@LIMITS
@pytest.mark.parametrize("name", ["scene.zarr", "T.npz", "T.mat"])
def test_a_full_disk_leaves_the_old_output_and_nothing_else(tmp_path: Path, name: str) -> None:
    write = store.save if name.endswith("zarr") else export
    big = transport((400, 30), density=0.5)
    with largest_file(20_000), pytest.raises(OutputError, match="cannot be written"):
        write(tmp_path / name, big)
    assert not list(tmp_path.iterdir())
    write(tmp_path / name, transport())
    with largest_file(20_000), pytest.raises(OutputError, match="cannot be written"):
        write(tmp_path / name, big, overwrite=True)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    if name == "scene.zarr":
        assert_same(store.open(tmp_path / name), transport())


def test_what_is_no_matrix_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        store.open(tmp_path / "scene.zarr")
    (tmp_path / "file.zarr").touch()
    (tmp_path / "folder.zarr").mkdir()
    for name in ("file.zarr", "folder.zarr"):
        with pytest.raises(InputError, match="is not a light transport matrix"):
            store.open(tmp_path / name)
    store.save(tmp_path / "scene.zarr", transport())
    header = tmp_path / "scene.zarr" / "zarr.json"
    content = json.loads(header.read_text())
    content["attributes"]["version"] = 99
    header.write_text(json.dumps(content))
    with pytest.raises(InputError, match="format version 99"):
        store.open(tmp_path / "scene.zarr")
    header.write_text("{")
    with pytest.raises(InputError, match="is not a light transport matrix"):
        store.open(tmp_path / "scene.zarr")


@pytest.mark.parametrize("array", ["indptr", "indices", "data", "background", "diagnostics/gap"])
@pytest.mark.parametrize("damage", ["missing", "cut", "no array"])
def test_damage_is_noticed(tmp_path: Path, array: str, damage: str) -> None:
    store.save(tmp_path / "scene.zarr", transport())
    place = tmp_path / "scene.zarr" / array
    if damage == "no array":
        (place / "zarr.json").write_text("{}")
    else:
        chunk = next(file for file in (place / "c").rglob("*") if file.is_file())
        if damage == "missing":
            chunk.unlink()
        else:
            chunk.write_bytes(chunk.read_bytes()[:-5])
    name = array if damage == "no array" else chunk.relative_to(place.parent).as_posix()
    with pytest.raises(InputError, match=rf"is damaged[\s\S]*{name}[\s\S]*overwrite=True"):
        store.open(tmp_path / "scene.zarr")


# ---- exchange


@given(st.integers(0, 2**31), st.sampled_from([(5, 4), (3, 2, 3), (1, 1)]), st.floats(0, 1))
@settings(max_examples=25, deadline=None)
def test_npz_comes_back(
    tmp_path_factory: pytest.TempPathFactory, seed: int, camera: tuple[int, ...], density: float
) -> None:
    path = tmp_path_factory.mktemp("npz") / "T.npz"
    written = transport(camera, seed, density)
    export(path, written)
    assert_same(import_npz(path), written)
    assert (scipy.sparse.load_npz(path) != written.sparse).nnz == 0


def test_npz_with_the_background_spread_is_the_whole_matrix(tmp_path: Path) -> None:
    written = transport()
    export(tmp_path / "T.npz", written, dense_background=True)
    whole = written.to_matrix(dense_background=True).toarray()
    np.testing.assert_array_equal(scipy.sparse.load_npz(tmp_path / "T.npz").toarray(), whole)
    back = import_npz(tmp_path / "T.npz")
    assert not back.background.any()
    patterns = np.random.default_rng(0).random((3, 6, 7))
    np.testing.assert_allclose(back.relight(patterns), written.relight(patterns), rtol=1e-5)


@pytest.mark.parametrize("dense", [False, True])
def test_mat_is_read_by_matlab_s_rules(tmp_path: Path, dense: bool) -> None:
    written = transport()
    export(tmp_path / "T.mat", written, dense_background=dense)
    content = loadmat(tmp_path / "T.mat")
    expected = written.to_matrix(dense_background=dense).toarray()
    np.testing.assert_array_equal(content["T"].toarray(), expected)
    assert content["T"].dtype == np.float64
    assert content["background"].any() != dense
    np.testing.assert_array_equal(content["projector_shape"], [[6, 7]])


def test_npz_of_others(tmp_path: Path) -> None:
    matrix = transport().sparse
    scipy.sparse.save_npz(tmp_path / "plain.npz", matrix)
    with pytest.raises(InputError, match="does not say the shapes"):
        import_npz(tmp_path / "plain.npz")
    np.savez(tmp_path / "other.npz", values=np.zeros(3))
    (tmp_path / "text.npz").write_text("no archive")
    export(tmp_path / "half.npz", transport())
    whole = (tmp_path / "half.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("text.npz", "half.npz"):
        with pytest.raises(InputError, match="cannot be read as npz"):
            import_npz(tmp_path / name)
    with pytest.raises(InputError, match="no sparse matrix: format, shape, data"):
        import_npz(tmp_path / "other.npz")
    mark: dict[str, Any] = {CORRESPONDENCE_MARK: np.ones(1)}
    np.savez(tmp_path / "decoded.npz", **mark)
    with pytest.raises(InputError, match="for `lightmatrix triangulate`"):
        import_npz(tmp_path / "decoded.npz")
    with pytest.raises(InputError, match="no such file"):
        import_npz(tmp_path / "none.npz")


# ---- running results


def test_an_interrupted_estimate_continues_where_it_stopped(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.zarr.partial"]
    with pytest.raises(InputError, match="the estimate is incomplete"):
        store.open(path)
    assert run(path) == 16
    assert_same(store.open(path), transport())
    for name, values in transport().diagnostics.items():
        np.testing.assert_array_equal(store.open(path).diagnostics[name], values)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.zarr"]


def test_nothing_is_left_of_a_run_that_finished_no_tile(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "scene.zarr", fail_at=0)
    assert not list(tmp_path.iterdir())


KILLED = """
import os, signal, sys
import numpy as np
sys.path.insert(0, {tests!r})
from tests.helpers import stores
save, tiles = np.savez, []
def half(path, **arrays):
    tiles.append(path)
    if len(tiles) == 3:
        save(path, **arrays)
        os.truncate(path, 100)
        os.kill(os.getpid(), signal.SIGKILL)
    save(path, **arrays)
np.savez = half
stores.run(stores.Path({path!r}))
"""


@SIGNALS
def test_a_killed_run_loses_only_the_tile_it_was_writing(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    script = KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    killed = subprocess.run([sys.executable, "-c", script], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not path.exists()
    assert run(path) == 16
    assert_same(store.open(path), transport())
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.zarr"]


def test_tiles_of_other_settings_are_neither_used_nor_lost(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    other = {**FINGERPRINT, "regularization": 0.1}
    with pytest.raises(OutputError, match=r"other settings \(regularization was 0.3, is 0.1\)"):
        Checkpoint.open(path, other)
    assert run(path) == 16
    store.save(path, transport(seed=5), overwrite=True)
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16, overwrite=True)
    with Checkpoint.open(path, other, overwrite=True) as running:
        assert running.spans() == []


def test_a_complete_output_needs_overwrite_and_stays_until_replaced(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    store.save(path, transport(seed=5))
    with pytest.raises(OutputError, match="overwrite=True"):
        run(path)
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=8, overwrite=True)
    assert_same(store.open(path), transport(seed=5))
    run(path, overwrite=True)
    assert_same(store.open(path), transport())


def test_another_tiling_keeps_what_is_there_and_a_damaged_tile_is_computed_again(
    tmp_path: Path,
) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    tile = tmp_path / "scene.zarr.partial" / "rows-0-8.npz"
    tile.write_bytes(tile.read_bytes()[:200])
    with Checkpoint.open(path, FINGERPRINT) as running:
        assert running.spans() == [(8, 16)]
        with pytest.raises(InputError, match="do not cover all 20 rows"):
            finish(running)
        missing = unfinished_spans([(0, 10), (10, 20)], running.spans())
        assert missing == [(0, 8), (16, 20)]
        for start, stop in missing:
            write_tile(running, start, stop)
        assert_same(finish(running), transport())


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("mark", None),
        ("indices", None),
        ("shape", lambda values: values + 1),
        ("data", lambda values: values * np.nan),
        ("indices", lambda values: np.full_like(values, 42)),
        ("indptr", lambda values: values[::-1]),
    ],
)
def test_a_changed_tile_is_computed_again(
    tmp_path: Path, key: str, change: Callable[[NDArray[Any]], NDArray[Any]] | None
) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    tile = tmp_path / "scene.zarr.partial" / "rows-0-8.npz"
    with np.load(tile) as held:
        arrays = dict(held)
    old = arrays.pop(key)
    if change is not None:
        arrays[key] = change(old)
    np.savez(tile, **arrays)
    assert run(path) == 8
    assert_same(store.open(path), transport())


@pytest.mark.parametrize("lost", [True, False])
def test_a_tile_that_is_damaged_meanwhile_is_named(tmp_path: Path, lost: bool) -> None:
    with Checkpoint.open(tmp_path / "t.zarr", FINGERPRINT) as running:
        for start, stop in TILES:
            write_tile(running, start, stop)
        assert running.read(ROWS).count == TILES[-1][1]
        file = next((tmp_path / "t.zarr.partial").glob("rows-*.npz"))
        file.write_bytes(b"")
        if lost:
            file.unlink()
        with pytest.raises(InputError, match=r"rows-\d+-\d+\.npz was damaged meanwhile"):
            running.read(ROWS)


def test_tiles_under_each_others_names_are_computed_again(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    first, second = (tmp_path / "scene.zarr.partial" / f"rows-{n}.npz" for n in ("0-8", "8-16"))
    first.rename(tmp_path / "other")
    second.rename(first)
    (tmp_path / "other").rename(second)
    assert run(path) == 0
    assert_same(store.open(path), transport())
