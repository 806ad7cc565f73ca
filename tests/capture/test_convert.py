"""Captures in the layouts of other programs become capture folders."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main

GENERATOR = np.random.default_rng(0)
PICTURES = GENERATOR.integers(0, 256, (12, 4, 6, 3), np.uint8)
PHOTOGRAPHS = GENERATOR.integers(0, 256, (12, 5, 7, 3), np.uint8)


def write(folder: Path, images: np.ndarray, name: str) -> None:
    for number, image in enumerate(images):
        lm.write_image(folder / name.format(number), image)


def test_compennet_keeps_one_channel(tmp_path: Path) -> None:
    setup = tmp_path / "data/light1/pos1/cloud"
    write(tmp_path / "data/train", PICTURES, "img_{:04}.png")
    write(tmp_path / "data/ref", PICTURES[:2], "img_{:04}.png")
    write(setup / "cam/raw/train", PHOTOGRAPHS, "img_{:04}.png")
    assert lm.convert(setup, tmp_path / "c", channel="blue", response="gamma:2.2") == "CompenNet"
    capture = lm.Capture.open(tmp_path / "c")
    assert capture.patterns.images() == pytest.approx(PICTURES[..., 2] / 255, abs=1e-6)
    assert (capture.frame(3) == PHOTOGRAPHS[3, ..., 2]).all()
    assert capture.decoder.response.name == "gamma:2.2"
    with pytest.raises(lm.InputError, match="no folder above"):
        lm.convert(_moved(setup, tmp_path / "elsewhere"), tmp_path / "d")


def _moved(folder: Path, place: Path) -> Path:
    folder.rename(place)
    return place


def test_slstudio_orders_by_number(tmp_path: Path) -> None:
    write(tmp_path / "s", PICTURES[..., 0], "pat_{}.png")
    write(tmp_path / "s", PHOTOGRAPHS[..., 0], "frameSeq_{}.png")
    assert lm.convert(tmp_path / "s", tmp_path / "c") == "SLStudio"
    capture = lm.Capture.open(tmp_path / "c")
    assert (capture.frame(11) == PHOTOGRAPHS[11, ..., 0]).all()
    assert capture.patterns.images()[11] == pytest.approx(PICTURES[11, ..., 0] / 255, abs=1e-6)
    (tmp_path / "s/frameSeq_3.png").unlink()
    with pytest.raises(lm.InputError, match="12 patterns, but 11 frames"):
        lm.convert(tmp_path / "s", tmp_path / "d")


@pytest.mark.parametrize(
    "text", ["file,exposure\na.png,0.25\nb.png,1\n", " a.png , 0.25\n b.png , 1\n"]
)
def test_brackets_repeat_their_pattern_at_every_exposure(tmp_path: Path, text: str) -> None:
    write(tmp_path / "s/patterns", PICTURES[:3, ..., 0], "{}.png")
    for pattern in range(3):
        for number, letter in enumerate("ab"):
            image = PHOTOGRAPHS[2 * pattern + number, ..., 0]
            lm.write_image(tmp_path / f"s/{pattern + 9:02}/{letter}.png", image)
    (tmp_path / "s/exposures.csv").write_text(text)
    assert lm.convert(tmp_path / "s", tmp_path / "c") == "brackets"
    capture = lm.Capture.open(tmp_path / "c")
    assert capture.exposures.tolist() == [0.25, 1] * 3
    assert (capture.frame(5) == PHOTOGRAPHS[5, ..., 0]).all()
    shown = capture.patterns.images()
    assert (shown[4] == shown[5]).all()
    assert not (shown[3] == shown[4]).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [("a.png,1\nb.png,0", "no list"), ("a.png,1", "has no exposure"), ("a.png,fast\n", "no list"),
     ("a.png,0,5\nb.png,0,25\n", "no list"), ("a.png,1\na.png,2\n", "no list"),
     ("1\n0.25\n", "no list"), ("a.png,1\nb.png\n", "no list"),
     ("a.png," + "1" * 200_000, "field larger"), ("", "no list")],
)  # fmt: skip
def test_bad_exposures_are_named(tmp_path: Path, text: str, words: str) -> None:
    write(tmp_path / "s/patterns", PICTURES[:1, ..., 0], "{}.png")
    for letter in "ab":
        lm.write_image(tmp_path / f"s/0/{letter}.png", PHOTOGRAPHS[0, ..., 0])
    (tmp_path / "s/exposures.csv").write_text(text)
    with pytest.raises(lm.InputError, match=words):
        lm.convert(tmp_path / "s", tmp_path / "c")


def test_other_folders_are_refused_with_the_layouts(tmp_path: Path) -> None:
    with pytest.raises(lm.InputError) as caught:
        lm.convert(tmp_path, tmp_path / "c")
    assert "CompenNet" in (caught.value.hint or "")
    with pytest.raises(lm.InputError, match="no such folder"):
        lm.convert(tmp_path / "nothing", tmp_path / "c")
    (tmp_path / "1").mkdir()
    write(tmp_path / "patterns", PICTURES[:2, ..., 0], "{}.png")
    with pytest.raises(lm.InputError, match="2 patterns, but 1 numbered"):
        lm.convert(tmp_path, tmp_path / "c")
    write(tmp_path / "2", PHOTOGRAPHS[:1, ..., 0], "{}.png")
    with pytest.raises(lm.InputError, match="no such file"):
        lm.convert(tmp_path, tmp_path / "c")


def test_the_command_converts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "s", PICTURES[..., 0], "pat_{}.png")
    write(tmp_path / "s", PHOTOGRAPHS[..., 0], "frameSeq_{:02}.png")
    words = ["convert", str(tmp_path / "s"), "-o", str(tmp_path / "c"), "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["layout"] == "SLStudio"
    lm.convert(tmp_path / "s", tmp_path / "d")
    assert lm.Capture.open(tmp_path / "c").digest == lm.Capture.open(tmp_path / "d").digest
    assert main(words) == 2
