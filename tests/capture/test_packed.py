"""Packed captures: the same capture in one array, read tile by tile; damage is named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lightmatrix as lm
from lightmatrix.capture import packing
from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.frames import PixelFrames
from lightmatrix.capture.packed import PackedFrames
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.check.all_checks import check_capture
from lightmatrix.cli import main
from lightmatrix.errors import InputError, OutputError
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.truth import binned

SHAPE, COUNT = (6, 9), 5


def patterns(kind: str) -> PatternSet:
    if kind == "grey":
        stack = np.random.default_rng(1).integers(0, 256, (COUNT, *SHAPE)) / np.float32(255)
        return lm.ImagePatterns(stack.astype(np.float32))
    if kind == "colour":
        return lm.colour_bernoulli(SHAPE, COUNT, grey=2)
    if kind == "bits":
        return lm.BernoulliPatterns(SHAPE, 2 * COUNT, seed=3).subset(np.arange(COUNT))
    return lm.BernoulliPatterns(SHAPE, COUNT, 0.4, 7)


def capture(
    camera: tuple[int, ...] = (5, 7), dtype: Any = np.uint8, kind: str = "bernoulli", **decoder: Any
) -> Capture:
    """Random frames, which hold every level."""
    generator = np.random.default_rng(2)
    size = (COUNT, *camera)
    top = 1.0 if dtype is np.float32 else float(np.iinfo(dtype).max)
    frames = (top * generator.random(size)).astype(dtype)
    levels: dict[str, Any] = {"clip": 0.9 * top, "full_scale": top, **decoder}
    mask = generator.random(camera) < 0.9
    return Capture.from_arrays(
        patterns(kind), frames, Decoder(**levels), mask=mask, provenance={"seed": 1}
    )


def assert_same(reopened: Capture, original: Capture) -> None:
    assert reopened.digest == original.digest
    assert {**reopened.description, "response": ""} == {**original.description, "response": ""}
    assert reopened.patterns.description == original.patterns.description
    assert type(reopened.patterns) is type(original.patterns)
    assert reopened.decoder.clip_assumed == original.decoder.clip_assumed
    for k in range(COUNT):
        np.testing.assert_array_equal(reopened.frame(k), original.frame(k))
        assert reopened.frames.name(k) == original.frames.name(k)


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packing, "_CHUNK_BYTES", 40)


LEVELS = np.linspace(0, 1, 7)
DECODERS: dict[str, dict[str, Any]] = {
    "plain": {},
    "assumed": {"clip": 255.0, "clip_assumed": True},
    "levels of each frame": {
        "clip": np.linspace(200, 240, COUNT),
        "black_level": np.linspace(3, 9, COUNT),
        "exposure": np.linspace(0.5, 2, COUNT),
    },
    "a black frame": {
        "black_level": 2.0,
        "black_frame": np.random.default_rng(3).integers(0, 30, 35).astype(np.uint8),
        "black_exposure": 0.5,
        "exposure": np.linspace(0.5, 2, COUNT),
    },
    "gamma": {"response": Response.parse("gamma:2.2")},
    "to be found": {"response": Response.parse("auto")},
    "a curve": {"response": Response(LEVELS, LEVELS**1.5, "curve:gone.txt")},
}


@pytest.mark.parametrize("words", DECODERS)
@pytest.mark.usefixtures("small_chunks")
def test_a_packed_capture_is_the_same_capture(tmp_path: Path, words: str) -> None:
    original = capture(**DECODERS[words])
    lm.pack(original, tmp_path / "c.zarr")
    reopened = Capture.open(tmp_path / "c.zarr")
    assert isinstance(reopened.frames, PackedFrames)
    assert_same(reopened, original)
    for block in ((2, 2), (3, 8)):
        assert reopened.bin(camera=block).digest == original.bin(camera=block).digest
    part = slice(1, 4), slice(2, 6)
    assert reopened.window(*part).digest == original.window(*part).digest
    some = [3, 0]
    assert reopened.window(*part).select(some).digest == original.window(*part).select(some).digest
    assert [entry.name for entry in tmp_path.iterdir()] == ["c.zarr"]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("camera", [(5, 7), (4, 3, 3), (1, 1)])
@pytest.mark.parametrize("kind", ["bernoulli", "bits", "grey", "colour"])
def test_all_kinds_of_frames_and_patterns(
    tmp_path: Path, camera: tuple[int, ...], dtype: Any, kind: str
) -> None:
    original = capture(camera, dtype, kind)
    lm.pack(original, tmp_path / "c.zarr")
    assert_same(Capture.open(tmp_path / "c.zarr"), original)


@given(st.integers(0, 35), st.integers(0, 35), st.integers(1, 300), st.data())
@settings(max_examples=10, deadline=None)
def test_any_run_of_samples_is_that_of_the_frames(
    tmp_path_factory: pytest.TempPathFactory, one: int, other: int, chunk: int, data: st.DataObject
) -> None:
    place = tmp_path_factory.mktemp("run") / "c.zarr"
    original = capture()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packing, "_CHUNK_BYTES", chunk)
        lm.pack(original, place)
    reopened = Capture.open(place)
    rows = sorted((one, other))
    for _ in range(2):
        np.testing.assert_array_equal(reopened.levels(*rows), original.raw[slice(*rows)])
    at = data.draw(st.integers(0, 34))
    np.testing.assert_array_equal(reopened.levels(at, at + 1)[0], original.raw[at])


@pytest.mark.usefixtures("small_chunks")
def test_packed_and_cropped_in_either_order_are_the_same(tmp_path: Path) -> None:
    whole = capture(**DECODERS["a black frame"])
    original = whole.crop((1, 2), (3, 4))
    lm.pack(whole, tmp_path / "whole.zarr")
    lm.pack(original, tmp_path / "part.zarr")
    cropped = Capture.open(tmp_path / "whole.zarr", crop=((1, 2), (3, 4)))
    assert isinstance(cropped.frames, PixelFrames)
    for reopened in (cropped, Capture.open(tmp_path / "part.zarr")):
        assert_same(reopened, original)
    inner = (1, 1), (2, 2)
    assert cropped.crop(*inner).digest == original.crop(*inner).digest
    assert cropped.crop(*inner).description["crop"]["corner"] == [2, 3]
    some = [3, 0]
    assert cropped.select(some).digest == original.select(some).digest


def test_a_tile_reads_only_its_own_chunks(tmp_path: Path, small_chunks: None) -> None:
    lm.pack(capture(), tmp_path / "c.zarr")
    frames = Capture.open(tmp_path / "c.zarr").frames
    assert isinstance(frames, PackedFrames)
    assert frames.array.chunks == (COUNT, 1, 7)
    # Nothing but the third row of the camera is left on the disk.
    for row in (0, 1, 3, 4):
        frames.array.chunk_file((0, row, 0)).unlink()
    assert frames.levels(14, 21).shape == (7, COUNT)
    with pytest.raises(InputError, match=r"the chunk frames/c/0/3/0 is missing"):
        frames.levels(14, 22)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated capture as a folder, and packed."""
    place = tmp_path_factory.mktemp("simulated")
    known = binned(lm.truth("metal"), 4)
    simulated = lm.simulate(known, lm.BernoulliPatterns((16, 16), 24), exposure=0.3, leak=0.1)
    simulated.save(place / "capture")
    simulated.save(place / "simulated.zarr")
    lm.pack(place / "capture", place / "packed.zarr")
    return place


@pytest.mark.parametrize("name", ["packed.zarr", "simulated.zarr"])
def test_a_packed_capture_replaces_the_folder_everywhere(folder: Path, name: str) -> None:
    original = Capture.open(folder / "capture")
    reopened = Capture.open(folder / name)
    assert reopened.digest == original.digest
    assert reopened.description == original.description
    assert check_capture(reopened) == check_capture(original)
    known = lm.truth(folder / name / "truth.npz")
    assert known.matrix.nnz == lm.truth(folder / "capture" / "truth.npz").matrix.nnz
    estimator = PlainEstimator(lm.ROMP(max_iterations=2), tile_rows=77)
    one, other = estimator.estimate(reopened), estimator.estimate(original)
    assert (one.sparse != other.sparse).nnz == 0
    assert one.provenance == other.provenance


def test_the_command_packs_plain_folders(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = f"--patterns {folder}/capture/patterns --images {folder}/capture/images --black 3"
    assert main(f"pack {plain} -o {folder}/plain.zarr --json".split()) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 24
    inside = folder / "capture"
    original = Capture.from_folders(inside / "patterns", inside / "images", ReadSettings(black=3))
    assert Capture.open(folder / "plain.zarr").digest == original.digest


def _header(change: dict[str, Any], name: str = "zarr.json") -> Any:
    def damage(place: Path) -> None:
        file = place / name
        content = json.loads(file.read_text())
        (content["attributes"] if name == "zarr.json" else content).update(change)
        file.write_text(json.dumps(content))

    return damage


DAMAGES: dict[str, tuple[Any, str]] = {
    "a later version": (_header({"version": 2}), "has format version 2, this lightmatrix reads 1"),
    "no frames": (_header({"format": "other"}), "is not a set of packed frames"),
    "other names": (_header({"names": ["a"]}), "its frames have shape"),
    "no names": (_header({"names": 5}), "its frames have no names"),
    "a huge camera": (_header({"shape": [5, 10**6, 10**6]}, "frames/zarr.json"), "announces"),
    "no array": (lambda place: shutil.rmtree(place / "frames"), "is damaged"),
}


@pytest.mark.parametrize("words", DAMAGES)
def test_damaged_and_hostile_packed_frames_are_refused(tmp_path: Path, words: str) -> None:
    lm.pack(capture(), tmp_path / "c.zarr")
    damage, message = DAMAGES[words]
    damage(tmp_path / "c.zarr" / "images.zarr")
    with pytest.raises(InputError, match=message):
        Capture.open(tmp_path / "c.zarr")


@pytest.mark.parametrize("how", ["cut", "flipped", "grown"])
def test_a_damaged_chunk_is_named(tmp_path: Path, how: str, small_chunks: None) -> None:
    lm.pack(capture(), tmp_path / "c.zarr")
    chunk = tmp_path / "c.zarr" / "images.zarr" / "frames" / "c" / "0" / "2" / "0"
    data = bytearray(chunk.read_bytes())
    if how == "flipped":
        data[-6] ^= 1
    elif how == "grown":
        # It says that it inflates to 2 GiB.
        data[4:8] = (2**31).to_bytes(4, "little")
    chunk.write_bytes(data[:-3] if how == "cut" else data)
    reopened = Capture.open(tmp_path / "c.zarr")
    with pytest.raises(InputError, match=r"images\.zarr: is damaged .*frames/c/0/2/0"):
        reopened.samples()
    assert reopened.samples(0, 14).count == 14


def test_disk_space_is_checked_before_a_frame_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=100)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    original = capture()
    read: list[int] = []
    monkeypatch.setattr(type(original.frames), "read", lambda self, k: read.append(k))
    with pytest.raises(OutputError, match=r"takes up to 175 bytes, 100 bytes are free"):
        lm.pack(original, tmp_path / "c.zarr")
    assert not read
    assert not list(tmp_path.iterdir())


def test_black_and_white_images_give_the_estimate_of_the_generated_set(
    folder: Path, tmp_path: Path
) -> None:
    shutil.copytree(folder / "capture", tmp_path / "c")
    (tmp_path / "c" / "patterns" / "patterns.json").unlink()
    generated, read = Capture.open(folder / "capture"), Capture.open(tmp_path / "c")
    assert isinstance(generated.patterns, lm.BernoulliPatterns)
    assert isinstance(read.patterns, lm.BitPatterns)
    assert read.digest == generated.digest
    for coherent in (False, True):
        one, other = (
            lm.estimate(capture, coherent=coherent, check=False, correct="none")
            for capture in (generated, read)
        )
        assert (one.sparse != other.sparse).nnz == 0
        np.testing.assert_array_equal(one.background, other.background)
