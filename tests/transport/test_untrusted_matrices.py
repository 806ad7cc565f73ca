"""Stores, npz files and running results may hold anything: they are checked whole or refused."""

from __future__ import annotations

import io
import json
import os
import shutil
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from lightmatrix.errors import InputError
from lightmatrix.resources import memory
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport import store
from lightmatrix.transport.checkpoint import Checkpoint
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.npz import export, import_npz
from lightmatrix.transport.sparse_rows import checked_matrix
from lightmatrix.transport.store import seal
from tests.helpers.stores import FINGERPRINT, TILES, assert_same, run, transport
from tests.helpers.systems import PIPES


def rewrite(place: Path, name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    """Change an array of a store, stored as lightmatrix stores it."""
    group = zarr.open_group(place, mode="r+")
    values = change(np.asarray(group[name][...]))  # type: ignore[index]
    del group[name]
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=tuple(max(1, n) for n in values.shape),
        dtype=values.dtype,
        compressors=[BloscCodec(cname="zstd", clevel=5, shuffle="shuffle"), Crc32cCodec()],
        config={"write_empty_chunks": True},
    )
    array[...] = values
    seal(place)


def put(index: int, value: float) -> Callable[[NDArray[Any]], NDArray[Any]]:
    def change(values: NDArray[Any]) -> NDArray[Any]:
        values.flat[index] = value
        return values

    return change


WRONG: dict[str, tuple[str, Callable[[NDArray[Any]], NDArray[Any]], str]] = {
    "index of the first column too many": ("indices", put(3, 42), "lies outside the 42 columns"),
    "index far away": ("indices", put(-1, 2**31 - 1), "lies outside"),
    "negative index": ("indices", put(0, -1), "lies outside"),
    "float indices": ("indices", lambda v: v.astype(float), "indices holds float64"),
    "indptr falls": ("indptr", put(5, 10**6), "indptr does not rise"),
    "indptr beyond the end": ("indptr", put(-1, 10**6), "indptr does not rise"),
    "indptr below the end": ("indptr", put(-1, 3), "indptr does not rise"),
    "indptr of unsigned numbers": ("indptr", lambda v: v[::-1].astype(np.uint64), "holds uint64"),
    "indptr from 1": ("indptr", put(0, 1), "indptr does not rise"),
    "indptr too short": ("indptr", lambda v: v[:-1], "indptr"),
    "fewer values": ("data", lambda v: v[:-1], "indices has shape"),
    "not a number": ("data", put(2, np.nan), "data holds values that are not finite"),
    "infinite": ("data", put(2, np.inf), "data holds values that are not finite"),
    "beyond float32": ("data", lambda v: v.astype(float) * 1e300, "data holds float64"),
    "background not a number": ("background", put(7, np.nan), "not finite"),
    "background of other blocks": ("background", lambda v: v[:, :5], "background has shape"),
    "background of other rows": ("background", lambda v: v[:-1], "background has shape"),
    "diagnostic of other rows": ("diagnostics/gap", lambda v: v[:-1], "diagnostics/gap has shape"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_store_that_contradicts_itself(tmp_path: Path, name: str) -> None:
    store.save(tmp_path / "scene.zarr", transport())
    array, change, message = WRONG[name]
    rewrite(tmp_path / "scene.zarr", array, lambda values: values)
    assert_same(store.open(tmp_path / "scene.zarr"), transport())
    rewrite(tmp_path / "scene.zarr", array, change)
    with pytest.raises(InputError, match=f"is damaged.*{message}"):
        store.open(tmp_path / "scene.zarr")


@pytest.mark.parametrize(
    "change",
    [
        {"camera_shape": [0, 5]},
        {"camera_shape": [5]},
        {"camera_shape": [-5, -4]},
        {"camera_shape": "54"},
        {"camera_shape": [5.0, 4.5]},
        {"camera_shape": [2**40, 2**40]},
        {"camera_shape": None},
        {"projector_shape": [6, 7, 1]},
        {"projector_shape": [2, 3]},
        {"background_grid": [0, 6]},
        {"provenance": "text"},
        {"provenance": [1]},
    ],
)
def test_attributes_that_no_store_has(tmp_path: Path, change: dict[str, Any]) -> None:
    store.save(tmp_path / "scene.zarr", transport())
    header = tmp_path / "scene.zarr" / "zarr.json"
    content = json.loads(header.read_text())
    content["attributes"] |= change
    header.write_text(json.dumps(content))
    with pytest.raises(InputError, match="is damaged"):
        store.open(tmp_path / "scene.zarr")


def edit(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def save_anew(place: Path) -> None:
    """A store in place of one that was edited, which `save` would not touch."""
    shutil.rmtree(place, ignore_errors=True)
    store.save(place, transport())


def test_other_codecs_and_other_versions_of_zarr_are_not_let_in(tmp_path: Path) -> None:
    place = tmp_path / "scene.zarr"
    changes: list[Callable[[dict[str, Any]], object]] = [
        lambda c: c["codecs"].append({"name": "numcodecs.pickle", "configuration": {}}),
        lambda c: c["codecs"].pop(),
        lambda c: c.update(zarr_format=2),
        lambda c: c["chunk_grid"]["configuration"].update(chunk_shape=[10**12]),
        lambda c: c["chunk_grid"]["configuration"].update(chunk_shape=[0]),
        lambda c: c.update(data_type="complex128"),
        lambda c: c.update(shape=[10**15]),
    ]
    for change in changes:
        save_anew(place)
        edit(place / "data" / "zarr.json", change)
        with pytest.raises(InputError, match="is damaged"):
            store.open(place)
    # What consolidated metadata says of the arrays is not believed.
    save_anew(place)
    with pytest.warns(UserWarning, match="Consolidated metadata"):
        zarr.consolidate_metadata(place)
    edit(
        place / "zarr.json",
        lambda c: c["consolidated_metadata"]["metadata"]["data"].update(
            codecs=[{"name": "numcodecs.pickle", "configuration": {}}]
        ),
    )
    assert_same(store.open(place), transport())
    # A group of version 2 beside it, with consolidated metadata of its own.
    (place / "zarr.json").unlink()
    (place / ".zgroup").write_text('{"zarr_format": 2}')
    (place / ".zmetadata").write_text('{"zarr_consolidated_format": 1, "metadata": {}}')
    with pytest.raises(InputError, match="is not a light transport matrix"):
        store.open(place)


@PIPES
def test_a_store_of_pipes_links_and_bombs(tmp_path: Path) -> None:
    place = tmp_path / "scene.zarr"
    for name in ("zarr.json", "data/zarr.json", "data/c/0"):
        save_anew(place)
        (place / name).unlink()
        os.mkfifo(place / name)
        with pytest.raises(InputError):
            store.open(place)
    save_anew(place)
    (place / "zarr.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match="is not a light transport matrix"):
        store.open(place)
    # A chunk that says that it inflates to 2 GiB.
    save_anew(place)
    chunk = place / "data" / "c" / "0"
    data = bytearray(chunk.read_bytes())
    data[4:8] = (2**31 - 1).to_bytes(4, "little")
    chunk.write_bytes(data)
    with pytest.raises(InputError, match="is not what the array needs"):
        store.open(place)


def test_more_than_fits_into_memory_is_said_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.save(tmp_path / "scene.zarr", transport())
    export(tmp_path / "T.npz", transport())
    monkeypatch.setattr(memory, "available_bytes", lambda: 100)
    for read in (store.open, import_npz):
        with pytest.raises(InputError, match="of memory, 100 bytes are free"):
            read(tmp_path / ("T.npz" if read is import_npz else "scene.zarr"))


# ---- npz


def content(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path) as file:
        return dict(file)


def save(path: Path, arrays: dict[str, Any]) -> None:
    np.savez_compressed(path, **arrays)


@pytest.fixture
def npz(tmp_path: Path) -> Path:
    export(tmp_path / "T.npz", transport())
    return tmp_path / "T.npz"


NPZ_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "shapes without dimensions": ({"camera_shape": np.array(20)}, "camera_shape is no shape"),
    "shape without dimensions": ({"shape": np.array(840)}, "the matrix is no shape"),
    "shape of floats": ({"shape": np.array([20.0, 42.0])}, "is no shape"),
    "shape below 0": ({"shape": np.array([-20, -42])}, "the matrix is -20 x -42"),
    "camera of other rows": ({"camera_shape": np.array([5, 5])}, r"for camera \(5, 5\)"),
    "objects": ({"data": np.array([{}], object)}, "cannot be loaded when allow_pickle"),
    "other version": ({"lightmatrix_transport": np.array(2)}, "format version 2"),
    "version of text": ({"lightmatrix_transport": np.array("x")}, "format version x"),
    "version of many": ({"lightmatrix_transport": np.arange(3)}, "format version None"),
    "NaN": ({"data": np.full(168, np.nan, np.float32)}, "not finite"),
    "background": ({"background": np.zeros((3, 6))}, "the background has shape"),
    "NaN background": ({"background": np.full((20, 6), np.nan)}, "not all finite"),
    "metadata of text": ({"metadata": np.array("text")}, "metadata: cannot be read"),
    "metadata of a list": ({"metadata": np.array("[1]")}, "dict as a provenance|a provenance"),
    "metadata without end": ({"metadata": np.array("[" * 100_000)}, "nested too deeply"),
    "another form": ({"format": np.array(b"csc")}, "form 'csc'; save it as csr"),
}


@pytest.mark.parametrize("name", NPZ_WRONG)
def test_npz_that_contradicts_itself(npz: Path, name: str) -> None:
    change, message = NPZ_WRONG[name]
    save(npz, content(npz) | change)
    with pytest.raises(InputError, match=message):
        import_npz(npz)
    with pytest.raises(InputError, match=message):
        Truth.load(npz)


def test_only_the_sides_of_a_matrix_are_limited(tmp_path: Path) -> None:
    """250 x 250 pixels under 250 x 250 make 3.9e9 elements."""
    side = 250
    matrix = scipy.sparse.csr_array(
        (np.ones(1, np.float32), ([70], [80])), shape=(side**2, side**2)
    )
    export(tmp_path / "T.npz", LightTransport.from_matrix(matrix, (side, side), (side, side)))
    read = import_npz(tmp_path / "T.npz")
    assert read.sparse[70, 80] == 1
    assert read.sparse.nnz == 1
    changed = content(tmp_path / "T.npz")
    changed["shape"] = np.array([side**2, 1 << 31])
    save(tmp_path / "T.npz", changed)
    with pytest.raises(InputError, match="2147483648"):
        import_npz(tmp_path / "T.npz")


def member(shape: tuple[int, ...], values: bytes, kind: str = "<f4") -> bytes:
    stream = io.BytesIO()
    header = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + values


def test_archives_that_numpy_never_wrote(npz: Path) -> None:
    whole = npz.read_bytes()
    for name, data in (
        ("notes.txt", b"hello"),
        ("more.npy", member((100,), bytes(16))),
        ("more.npy", b"no array"),
        ("more.npy", member((10**9, 10**9), b"")),
    ):
        npz.write_bytes(whole)
        with zipfile.ZipFile(npz, "a") as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a name that appears twice
            archive.writestr(name, data)
        with pytest.raises(InputError, match="cannot be read as npz"):
            import_npz(npz)


@PIPES
def test_a_zip_bomb_is_refused_by_what_it_announces(
    npz: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays = content(npz)
    wanted = memory.available_bytes() + (1 << 30)
    monkeypatch.setattr(memory, "available_bytes", lambda: 10 << 20)
    big = np.zeros(4 << 20, np.float32)
    save(npz, arrays | {"data": big, "indices": big.astype(np.int32)})
    assert npz.stat().st_size < 100_000 < wanted
    with pytest.raises(InputError, match=r"takes \d+\.?\d* MiB of memory, 10 MiB are free"):
        import_npz(npz)
    os.unlink(npz)
    os.mkfifo(npz)
    with pytest.raises(InputError, match="is a pipe"):
        import_npz(npz)


@given(st.integers(0, 2**31))
@settings(max_examples=100, deadline=None)
def test_a_checked_matrix_is_safe(seed: int) -> None:
    """Random arrays are refused, or make a matrix that is the one they spell."""
    generator = np.random.default_rng(seed)
    rows, cols, entries = generator.integers(1, 5, 3)
    indptr = np.sort(generator.integers(-1, entries + 2, rows + 1))
    indptr[[0, -1]] = (0, entries) if generator.random() < 0.7 else indptr[[0, -1]]
    indices = generator.integers(-1 if generator.random() < 0.3 else 0, cols, entries)
    data = generator.random(entries)
    try:
        matrix = checked_matrix(data, indices, indptr, (int(rows), int(cols)))
    except ValueError:
        return
    expected = np.zeros((rows, cols))
    for row in range(rows):
        for at in range(indptr[row], indptr[row + 1]):
            assert indices[at] >= 0
            expected[row, indices[at]] += data[at]
    np.testing.assert_allclose(matrix.toarray(), expected, rtol=1e-6)


# ---- running results


@PIPES
def test_files_that_are_no_tiles_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        run(path, fail_at=16)
    folder = tmp_path / "scene.zarr.partial"
    for name in ("rows-x-8.npz", "rows-8.npz", "rows-0-8-9.npz", "rows-8-0.npz", "rows-²-3.npz"):
        shutil.copy(folder / "rows-0-8.npz", folder / name)
    os.mkfifo(folder / "rows-16-20.npz")
    with Checkpoint.open(path, FINGERPRINT) as running:
        assert running.spans() == list(TILES[:2])
