"""Each fault of a capture is found and named; intact ones, of any kind, are left alone.

How often, over many captures, `python -m benchmarks.frame_checks` measures.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks import frame_checks
from lightmatrix.cli import main
from lightmatrix.diagnosis import jpeg
from lightmatrix.diagnosis.counts import missing_places
from lightmatrix.diagnosis.finding import KINDS
from lightmatrix.diagnosis.inverse_pairs import Pairs
from lightmatrix.diagnosis.single_frame import check_frame
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.files.image_stack import ImageStack

WINDOW = Path(__file__).parents[1] / "data" / "graycode-board"
BOARD = Path(os.environ.get("LIGHTMATRIX_BOARD", WINDOW))
CAMERA = lm.Decoder(clip=255, full_scale=255)
Images = NDArray[np.uint8]


def coded(frames: Images) -> Images:
    return np.rint(255 * (frames / 255.0) ** (1 / 2.2)).astype(np.uint8)


def compressed(frames: Images, quality: int = 60) -> Images:
    saved = [imageio.imwrite("<bytes>", f, extension=".jpg", quality=quality) for f in frames]
    return np.stack([imageio.imread(io.BytesIO(each)) for each in saved])


def exchanged(frames: Images, a: int, b: int) -> Images:
    order = np.arange(len(frames))
    order[[a, b]] = b, a
    return frames[order]


def told(found: list[lm.Finding]) -> list[tuple[str, tuple[int, ...]]]:
    assert {each.kind for each in found} <= set(KINDS)
    assert all(each.message and each.advice for each in found)
    return [(each.kind, each.frames) for each in found]


# ---- the real board


@pytest.fixture(scope="module")
def board() -> tuple[lm.PatternSet, Images]:
    frames = np.stack(list(ImageStack.open(BOARD / "capture_0")))
    return lm.read_patterns(BOARD / "graycode_pattern"), frames


def darkened(frames: Images) -> Images:
    dark = frames.copy()
    dark[9] = frames[41]
    return dark


def shifted(frames: Images) -> Images:
    late = np.roll(frames[21:], 2, axis=2)
    late[:, :, :2] = frames[21:, :, :2]
    return np.concatenate([frames[:21], late])


def flickering(frames: Images) -> Images:
    gain = 1 + 0.05 * np.sin(1 + 1.3 * np.arange(len(frames)))
    return np.rint(frames * gain[:, None, None]).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda frames: frames, []),
        (lambda frames: exchanged(frames, 4, 24), [("order", (4, 24))]),
        (lambda frames: exchanged(frames, 40, 41), [("black", (41,)), ("white", (40,))]),
        (darkened, [("frame", (9,))]),
        (coded, [("response", ())]),
        (compressed, [("jpeg", ())]),
        (shifted, [("motion", tuple(range(22, 42)))]),
        (flickering, [("flicker", ())]),
    ],
    ids=["intact", "swapped", "white and black", "black", "gamma", "JPEG", "shifted", "flicker"],
)
def test_faults_of_the_real_board_are_named(
    fault: Callable[[Images], Images],
    expected: list[tuple[str, tuple[int, ...]]],
    board: tuple[lm.PatternSet, Images],
) -> None:
    patterns, frames = board
    capture = lm.Capture.from_arrays(patterns, fault(frames), CAMERA)
    # Stripes never tell rows with several footprints.
    assert told(lm.check(capture)) == [("patterns", ()), *expected]


@pytest.mark.parametrize("place", [3, 17])
def test_the_frame_that_the_board_lacks_is_named(
    place: int, board: tuple[lm.PatternSet, Images]
) -> None:
    patterns, frames = board
    rest = np.delete(frames, place, axis=0)
    capture = lm.Capture.from_arrays(patterns.subset(np.arange(41)), rest, CAMERA)
    survey = Survey.take(capture.patterns, capture.frames, CAMERA)
    named = missing_places(replace(survey, patterns=patterns))
    assert place in named
    # A stripe and its inverse may be told apart by nothing.
    assert set(named) <= {place, place ^ 1}


def test_pairs_are_patterns_and_their_inverses(board: tuple[lm.PatternSet, Images]) -> None:
    pairs = Pairs.find(board[0])
    assert pairs is not None
    assert pairs.pairs == tuple((k, k + 1) for k in range(0, 40, 2))
    assert set(pairs.others) == {40, 41}
    assert Pairs.find(lm.BernoulliPatterns((16, 16), 32)) is None


# ---- simulated scenes


@pytest.fixture(scope="module")
def draws() -> dict[str, frame_checks.Draw]:
    """A capture of each scene, of 32 or 48 frames."""
    few = (draw for draw in frame_checks.draws(40, seed=5) if draw.patterns.count <= 48)
    return {draw.scene: draw for draw in few}


@pytest.mark.parametrize(
    ("fault", "scene"),
    [(fault, "metal") for fault in frame_checks.FAULTS]
    # Without outlines, and with footprints of several pixels.
    + [(fault, "corner") for fault in ("gamma 2.2", "shifted 2 px from the middle on")],
)
def test_faults_of_random_captures_are_named(
    fault: str, scene: str, draws: dict[str, frame_checks.Draw]
) -> None:
    found, named = frame_checks.FAULTS[fault](draws[scene], np.random.default_rng(1))
    assert named, [each.message for each in found]


def test_intact_captures_are_left_alone() -> None:
    assert frame_checks.intact(4, seed=11) == 0


def test_other_patterns_are_left_alone() -> None:
    for patterns in (
        lm.HadamardPatterns((64, 64), 64, "random", True),
        lm.make_patterns("mix", (64, 64), 64),
        lm.BernoulliPatterns((64, 64), 32, density=0.25),
    ):
        capture = lm.simulate("l_objects", patterns, exposure=0.4)
        assert lm.check(capture) == []


def test_colour_and_several_exposures_are_left_alone() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 48)
    capture = lm.simulate("metal", patterns, exposure="0.4:0.5,0.1:0.5", leak=0.01, ambient=0.05)
    assert lm.check(capture) == []
    grey = lm.simulate("metal", patterns, exposure=0.1)
    frames = np.stack([grey.frame(k) for k in range(48)])
    colour = np.rint(frames[..., None] * np.array([1, 0.8, 0.5])).astype(np.uint8)
    assert lm.check(lm.Capture.from_arrays(patterns, colour, CAMERA)) == []


# ---- what needs no prediction


def test_light(capsys: pytest.CaptureFixture[str]) -> None:
    patterns = lm.BernoulliPatterns((64, 64), 16)
    for exposure, word in ((30, "clipped"), (0.005, "raw levels above black")):
        found = lm.check(lm.simulate("metal", patterns, exposure=exposure, noise=0))
        assert [each.kind for each in found] == ["light"]
        assert word in found[0].message


def test_pixels_that_never_see_the_projector() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 16)
    frames = np.zeros((16, 220, 220), np.uint8)
    seen = lm.simulate("metal", patterns, exposure=0.1)
    for k in range(16):
        frames[k, 80:144, 80:144] = seen.frame(k)
    found = lm.check(lm.Capture.from_arrays(patterns, frames, CAMERA))
    assert [each.kind for each in found] == ["unseen"]


def test_patterns_that_cannot_tell_single_pixels() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32).coarse((8, 8)).images()
    blocks = lm.ImagePatterns(np.repeat(np.repeat(patterns, 8, axis=1), 8, axis=2))
    found = lm.check(lm.simulate("metal", blocks, exposure=0.2))
    assert "patterns" in [each.kind for each in found]


def test_a_bright_black_frame() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    capture = lm.simulate("metal", patterns, exposure=0.1)
    bright = replace(capture.decoder, black_frame=capture.frame(0).ravel())
    found = lm.check(replace(capture, decoder=bright))
    assert "black" in [each.kind for each in found]


def test_interchanged_folders() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 16)
    capture = lm.simulate("metal", patterns, exposure=0.1)
    photographs = np.stack([capture.frame(k) for k in range(16)])
    drawn = (patterns.images() * 255).astype(np.uint8)
    mixed = lm.Capture.from_arrays(
        lm.ImagePatterns((photographs / 255).astype(np.float32)), drawn, CAMERA
    )
    assert [each.kind for each in lm.check(mixed)] == ["interchanged"]


@pytest.mark.parametrize("quality", [30, 60, 90])
def test_the_quality_of_jpeg_is_told(quality: int) -> None:
    generator = np.random.default_rng(0)
    smooth = np.cumsum(generator.normal(0, 6, (4, 96, 96)), axis=2) + 128
    frames = np.rint(smooth.clip(0, 255)).astype(np.uint8)
    blocks = jpeg._blocks(compressed(frames, quality)[:, None].astype(np.float64))
    found = jpeg.likely_quality(blocks)
    assert found is not None
    assert abs(found - quality) <= 2
    assert jpeg.likely_quality(jpeg._blocks(frames[:, None].astype(np.float64))) is None


def test_single_frames_for_a_live_rig() -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure=0.2)
    image = capture.frame(0)
    assert check_frame(image, CAMERA) == []
    assert [f.kind for f in check_frame(image, CAMERA, index=3, previous=image)] == ["order"]
    assert [f.kind for f in check_frame(0 * image, CAMERA)] == ["frame"]
    assert check_frame(0 * image, CAMERA, lit=False) == []
    assert [f.kind for f in check_frame(0 * image + 255, CAMERA)] == ["light"]


# ---- the command


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.3)
    capture.save(tmp_path / "capture")
    return tmp_path / "capture"


def run(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[dict[str, object]]]:
    code = main(["check", *words.split(), "--json"])
    found = json.loads(capsys.readouterr().out)["findings"]
    assert all(set(each) == {"kind", "frames", "message", "advice"} for each in found)
    return code, found


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(folder), capsys) == (0, [])
    assert main(["check", str(folder)]) == 0
    assert "nothing wrong" in capsys.readouterr().out
    images = sorted((folder / "images").iterdir())
    images[3].write_bytes(images[4].read_bytes())
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("order", [3])]
    assert found == [each.as_dict() for each in lm.check(folder)]
    images[3].unlink()
    code, found = run(f"--patterns {folder}/patterns --images {folder}/images", capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("counts", [3])]
    assert "31 photographs" in str(found[0]["message"])
    assert main(["check", str(folder)]) == 1
    assert "counts: 32 patterns" in capsys.readouterr().out


def test_files_that_do_not_fit_together_are_findings(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = sorted((folder / "images").iterdir())
    for image in images[5:7]:
        imageio.imwrite(image, np.zeros((9, 9), np.uint8))
    images[8].write_bytes(b"no image")
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [each["kind"] for each in found] == ["files", "files"]
    assert [each["frames"] for each in found] == [[5, 6], [8]]


def test_no_capture_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["nowhere"], ["--patterns", "p"], ["c", "--clip", "3"]):
        assert main(["check", *words]) == 2
        assert "error:" in capsys.readouterr().err
    with pytest.raises(lm.InputError):
        lm.check()


def test_estimate_says_what_check_finds(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for image in (folder / "images").iterdir():
        imageio.imwrite(image, coded(imageio.imread(image)))
    words = ["estimate", str(folder), "-o", str(tmp_path / "x.zarr"), "--no-coherent", "--json"]
    assert main([*words, "--iterations", "2"]) == 0
    shown = capsys.readouterr()
    assert "response: " in shown.err
    assert [each["kind"] for each in json.loads(shown.out)["findings"]] == ["response"]


def test_options_say_all_that_a_description_does(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two plain folders with options are the capture folder with its capture.json."""
    exposures = "0.4:0.5,0.1:0.5"
    simulated = lm.simulate(
        "metal", lm.BernoulliPatterns((64, 64), 32), exposure=exposures, black_level=5, ambient=0.1
    )
    simulated.save(tmp_path / "several")
    several = tmp_path / "several"
    listed = tmp_path / "exposures.txt"
    listed.write_text("\n".join(f"{e:.17g}" for e in simulated.exposures))
    words = f"--patterns {several}/patterns --images {several}/images --black {several}/black.png "
    words += f"--black-exposure 0.4 --black-level 5 --clip 255 --full-scale 255 --exposure {listed}"
    assert run(words, capsys) == (0, [])
    made: list[lm.LightTransport] = []
    for where in (words, str(several)):
        output = tmp_path / f"{len(made)}.zarr"
        command = f"estimate {where} -o {output} --no-coherent --iterations 2 --no-check"
        assert main(command.split()) == 0
        made.append(lm.open(output))
    np.testing.assert_array_equal(made[0].sparse.data, made[1].sparse.data)
    capsys.readouterr()
    given = ",".join(f"{e:g}" for e in simulated.exposures)
    assert run(words.replace(str(listed), given), capsys) == (0, [])
    for wrong in ("nonsense", "1,2,x", "1,2,3"):
        assert main(["check", *words.replace(str(listed), wrong).split()]) in (2,)
        assert wrong[:3] in capsys.readouterr().err or wrong == "1,2,3"
