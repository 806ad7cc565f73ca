"""Matrices that stay on disk: their parts equal those of the matrix in memory."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.files import zarr_arrays
from lightmatrix.transport import column_index
from lightmatrix.transport import store as stores


def transport(camera: tuple[int, ...] = (9, 8)) -> lm.LightTransport:
    generator = np.random.default_rng(0)
    rows = int(np.prod(camera))
    matrix = scipy.sparse.random_array((rows, 42), density=0.2, rng=generator)
    background = generator.random((rows, 6)).astype(np.float32)
    diagnostics = {"gap": generator.random(rows)}
    return lm.LightTransport(
        csr_array(matrix, dtype=np.float32), background, camera, (6, 7), (2, 3), diagnostics, {}
    )


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zarr_arrays, "CHUNK", 30)
    monkeypatch.setattr(stores, "_BLOCK_ENTRIES", 70)


@pytest.mark.parametrize("camera", [(9, 8), (4, 5, 3), (1, 1)])
@pytest.mark.parametrize("memory", [0, 2000, 1 << 30])
def test_parts_equal_those_of_the_whole_matrix(
    tmp_path: Path, camera: tuple[int, ...], memory: int
) -> None:
    whole = transport(camera)
    lm.save(tmp_path / "s.zarr", whole)
    stored = lm.StoredTransport.open(tmp_path / "s.zarr", memory=memory)
    generator = np.random.default_rng(1)
    lit = generator.random((3, 6, 7))
    lights = generator.random(camera).astype(np.float32)
    # The second time, blocks may come from memory.
    for _ in range(2):
        np.testing.assert_allclose(stored.relight(lit), whole.relight(lit), rtol=1e-6)
        np.testing.assert_allclose(stored.relight(lit[0]), whole.relight(lit[0]), rtol=1e-6)
        np.testing.assert_allclose(stored.dual(lights), whole.dual(lights), rtol=1e-5)
        np.testing.assert_allclose(stored.column(3, 5), whole.column(3, 5), rtol=1e-6)
    last = tuple(n - 1 for n in camera)
    np.testing.assert_array_equal(stored.row(*last), whole.row(*last))
    rows = stored.rows(0, stored.shape[0])
    assert (rows.coefficients != whole.sparse).nnz == 0
    np.testing.assert_array_equal(rows.diagnostics["gap"], whole.diagnostics["gap"])
    loaded = stored.load()
    assert (loaded.sparse != whole.sparse).nnz == 0
    assert loaded.camera_shape == camera
    assert "42 entries" not in repr(stored)
    assert sum(map(stores._bytes, stored._kept.values())) <= memory


def test_a_region_is_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = transport()
    lm.save(tmp_path / "s.zarr", whole)
    line = f"export {tmp_path}/s.zarr {tmp_path}/T.npz --crop"
    assert main([*line.split(), "2,3:3x5"]) == 0
    rows = np.arange(72).reshape(9, 8)[2:5, 3:8].ravel()
    assert (scipy.sparse.load_npz(tmp_path / "T.npz") != whole.sparse[rows]).nnz == 0
    for words, message in (("2-5", "--crop '2-5'"), ("2,3:3x6", "of photographs of 9 x 8")):
        assert main([*line.split(), words, "--overwrite"]) == 2
        assert message in capsys.readouterr().err


def test_others_read_the_format_as_it_is_documented(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = transport((102, 2))
    lm.save(tmp_path / "scene.zarr", whole)
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "store-format.md"
    code = re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)
    assert len(code) == 1
    assert "lightmatrix" not in code[0]
    names: dict[str, Any] = {}
    exec(code[0], names)
    assert (names["rows"] != whole.sparse[200:202]).nnz == 0
    # A projector of 3 x 5 in tiles of 2 x 2, by what the page says of their order.
    monkeypatch.setattr(column_index, "_TILE", 2)
    order = [0, 1, 5, 6, 2, 3, 7, 8, 4, 9, 10, 11, 12, 13, 14]
    assert np.argsort(column_index.tile_places(np.arange(15), (3, 5))).tolist() == order


def test_only_the_chunks_that_are_asked_for_are_read_and_damage_is_named(tmp_path: Path) -> None:
    whole = transport()
    lm.save(tmp_path / "s.zarr", whole)
    chunks = sorted((tmp_path / "s.zarr" / "data" / "c").iterdir(), key=lambda file: int(file.name))
    assert len(chunks) > 10
    # The end of the matrix is damaged in two ways.
    chunks[-1].write_bytes(chunks[-1].read_bytes()[:-1])
    chunks[-5].unlink()
    stored = lm.StoredTransport.open(tmp_path / "s.zarr")
    np.testing.assert_array_equal(stored.row(1, 2), whole.row(1, 2))
    last = len(chunks) - 1
    with pytest.raises(InputError, match=rf"is damaged .*data/c/{last}\b"):
        stored.row(8, 7)
    with pytest.raises(InputError, match=rf"is damaged .*data/c/{last - 4} is missing"):
        stored.relight(np.ones((6, 7)))


def test_a_chunk_of_another_matrix_is_named_when_it_is_read(tmp_path: Path) -> None:
    whole = transport()
    lm.save(tmp_path / "s.zarr", whole)
    lm.save(tmp_path / "other.zarr", replace(whole, sparse=whole.sparse * np.float32(2)))
    chunks = sorted((tmp_path / "s.zarr" / "data" / "c").iterdir(), key=lambda file: int(file.name))
    last = chunks[-1].name
    shutil.copy(tmp_path / "other.zarr" / "data" / "c" / last, chunks[-1])
    stored = lm.StoredTransport.open(tmp_path / "s.zarr")
    np.testing.assert_array_equal(stored.row(1, 2), whole.row(1, 2))
    with pytest.raises(InputError, match=rf"data/c/{last} is not the one that was written"):
        stored.row(8, 7)


@pytest.mark.parametrize("how", ["saved anew", "removed", "exchanged", "the same again"])
def test_a_store_that_is_replaced_while_it_is_open_is_noticed(tmp_path: Path, how: str) -> None:
    whole, path = transport(), tmp_path / "s.zarr"
    lm.save(path, whole)
    lm.index_columns(path)
    stored, index = lm.StoredTransport.open(path, memory=0), lm.ColumnIndex.open(path)
    brighter = replace(whole, sparse=whole.sparse * np.float32(1.3))
    if how == "removed":
        shutil.rmtree(path)
    elif how == "exchanged":
        lm.save(tmp_path / "new.zarr", brighter)
        lm.index_columns(tmp_path / "new.zarr")
        path.rename(tmp_path / "old.zarr")
        (tmp_path / "new.zarr").rename(path)
    else:
        lm.save(path, brighter if how == "saved anew" else whole, overwrite=True)
        lm.index_columns(path)
    reads: dict[str, Callable[[], object]] = {
        "row": lambda: stored.row(1, 2),
        "rows": lambda: stored.rows(0, 9),
        "column": lambda: stored.column(3, 4),
        "relight": lambda: stored.relight(np.ones((6, 7))),
        "dual": lambda: stored.dual(np.ones((9, 8), np.float32)),
        "load": stored.load,
        "light": lambda: index.light(np.array([3]), np.ones(1)),
    }
    for read in reads.values():
        if how == "the same again":
            read()
            continue
        with pytest.raises(
            InputError, match=r"is missing|is not the one that was written"
        ) as refused:
            read()
        assert "open it again if it was replaced" in str(refused.value) or "index" in str(
            refused.value
        )
    if how == "the same again":
        np.testing.assert_array_equal(stored.row(8, 7), whole.row(8, 7))


def test_relighting_from_files_reads_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = transport()
    lm.save(tmp_path / "s.zarr", whole)
    shown = np.random.default_rng(2).random((6, 7))
    expected = lm.relight(whole, shown)
    monkeypatch.setattr("lightmatrix.transport.store.StoredTransport.load", None)
    np.testing.assert_allclose(lm.relight(tmp_path / "s.zarr", shown), expected, rtol=1e-6)
    with pytest.raises(InputError, match="rows 3 to 99"):
        lm.StoredTransport.open(tmp_path / "s.zarr").rows(3, 99)


@pytest.mark.parametrize("kept", [0, 200, 10_000])
def test_an_index_of_columns_gives_the_light_of_single_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: int
) -> None:
    monkeypatch.setattr(column_index, "_CHUNK", 25)
    monkeypatch.setattr(column_index, "_PASS_ENTRIES", 100)
    monkeypatch.setattr(column_index, "_TILE", 4)
    monkeypatch.setattr(column_index, "_KEPT_ENTRIES", kept)
    whole = transport()
    # Some samples have no background.
    faint = whole.background < np.median(whole.background)
    whole = replace(whole, background=np.where(faint, 0, whole.background))
    path = tmp_path / "s.zarr"
    lm.save(path, whole)
    with pytest.raises(InputError, match="has no index of its columns"):
        lm.ColumnIndex.open(path)
    lm.index_columns(path)
    index = lm.ColumnIndex.open(path)
    generator = np.random.default_rng(3)
    for listed in ([], [41], [30, 3, 4, 5, 41, 4], range(42)):
        pixels = np.array(listed, int)
        change = generator.normal(size=len(pixels))
        wanted = whole.dense_columns(pixels) @ change
        light = index.light(pixels, change)
        np.testing.assert_allclose(light.ravel(), wanted, atol=1e-6)
        entries = [tile.nnz for tile in index._kept.values()]
        assert len(entries) <= 1 or sum(entries) <= kept
    with pytest.raises(InputError, match="pixels up to 42"):
        index.light(np.array([42]), np.ones(1))
    with pytest.raises(InputError, match="has an index already"):
        lm.index_columns(path)
    lm.index_columns(path, overwrite=True)
    # The matrix is the same, and may be replaced together with its index.
    assert (lm.open(path).sparse != whole.sparse).nnz == 0
    lm.save(path, whole, overwrite=True)
    assert not (path / "columns").exists()
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.zarr"]


def test_the_index_of_another_matrix_is_refused(tmp_path: Path) -> None:
    whole = transport()
    other = replace(whole, background=np.ones((72, 18), np.float32), background_grid=(6, 3))
    for name, matrix in (("s.zarr", whole), ("other.zarr", other)):
        lm.save(tmp_path / name, matrix)
        lm.index_columns(tmp_path / name)
    shutil.rmtree(tmp_path / "s.zarr" / "columns")
    shutil.copytree(tmp_path / "other.zarr" / "columns", tmp_path / "s.zarr" / "columns")
    with pytest.raises(InputError, match="the index of another matrix"):
        lm.ColumnIndex.open(tmp_path / "s.zarr")


def test_a_damaged_index_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(column_index, "_CHUNK", 25)
    monkeypatch.setattr(column_index, "_TILE", 1)
    path = tmp_path / "s.zarr"
    lm.save(path, transport())
    lm.index_columns(path)
    chunk = path / "columns" / "indices" / "c" / "2"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    index = lm.ColumnIndex.open(path)
    with pytest.raises(InputError, match=r"columns: is damaged .*indices/c/2"):
        index.light(np.arange(42), np.ones(42))
    assert index.light(np.array([0]), np.ones(1)).shape == (9, 8)
    shutil.rmtree(path / "columns" / "data")
    with pytest.raises(InputError, match="columns: is damaged"):
        lm.ColumnIndex.open(path)
