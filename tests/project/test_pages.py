"""Every command and every line of Python on README and the pages of the docs runs, in order.

Each page runs in a folder of its own, among the files that it takes for granted. A command that
writes what an earlier one of its page wrote is another way to do the same, and replaces it.
"""

from __future__ import annotations

import contextlib
import doctest
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

import lightmatrix as lm
from lightmatrix.cli import main
from tests.helpers.board import POSES, board_capture, board_rig

ROOT = Path(__file__).parents[2]
PAGES = {path.stem: path for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
BLOCKS = re.compile(r"^```(sh|python|py)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
# The same at a smaller size, as only whether it runs is tested: sizes and numbers of patterns,
# places in them, photographs of a small board, and virtual devices that need not be waited for.
SMALLER = {
    r"\b(768x1024|1024x1024|1140x912|128x128|64x64)\b": "16x16",
    r"\b128x64\b": "32x16",
    r"(?<=--size )64\b": "16",
    r"(?<=\()64, 64(?=[,)])": "16, 16",
    r"(?<=-k )\d+|(?<=count=)64|(?<=frames=)32": "24",
    r"\b20, ?30\b": "5,7",
    r"\b10([01]) \* camera": r"1\1 * camera",
    r"16384": "16",
    r"--bin-camera 8": "--bin-camera 2",
    r"--workers 4": "--workers 2",
    r"--focal 3400": "--focal 32 --principal 1.1,11.5",
    r"\(512, 1024\)": "(8, 16)",
    r"9x7": "7x5",
    r"0 1 2 3 4": "0 1 2 3",
    r"300,450:256x320": "40,60:64x64",
    r"virtual:(\w+)(,size=32)?": r"virtual:\1,size=16,real=0",
}
OUTPUTS = ("-o", "--estimate", "--depth", "--report", "--picture")
PROGRAMS = "lightmatrix python pip git make dask v4l2-ctl ."
# What cannot run here, and why.
NOT_RUN = {
    r"^\. ": "names the programs of an environment",
    r"^make ": "builds and tests the project",
    r"^(pip|git|dask) ": "needs a network",
    r"--cluster|/shared/|Cluster\(": "needs a cluster; tests/estimators/test_workers.py",
    r"^lightmatrix rig list|--projector window": "takes devices; tests/rig",
    r"^v4l2-ctl": "sets a camera",
    r"^lightmatrix view [^-]*$|serve_viewer": "runs until Ctrl-C; tests/viewer",
    r"^lightmatrix track .*--watch": "waits for photographs; tests/estimators/test_tracking.py",
    r"^python -m experiments|bundled_scenes": "runs for hours; tests/experiments",
}


def _not_run(code: str) -> bool:
    return any(re.search(words, code) for words in NOT_RUN)


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What pages take for granted: a capture and its T, photographs, pictures, a board's poses."""
    folder = tmp_path_factory.mktemp("kitchen")
    with contextlib.chdir(folder):
        _make_captures()
        _make_pictures()
        _make_board()
    return folder


def _make_captures() -> None:
    patterns = lm.BernoulliPatterns((16, 16), 24)
    capture = lm.simulate("l_objects", patterns, exposure=0.5)
    capture.save("capture")
    lm.write_patterns("patterns", patterns)
    shutil.copytree("capture/images", "photos")
    np.save("patterns.npy", patterns.images())
    frames = np.stack([capture.frame(k) for k in range(capture.count)])
    first, *others = map(Image.fromarray, frames)
    first.save("photographs.tif", save_all=True, append_images=others)
    lm.estimate(capture, output="scene.zarr", check=False, correct="none")
    for name in ("left", "right", "red", "green", "blue"):
        shutil.copytree("scene.zarr", f"{name}.zarr")
    truth = capture.truth
    assert truth.geometry is not None
    truth.geometry.save("geometry.json")
    # Half of white, which random patterns average to: no pixel of it clips.
    lm.write_image("white.png", frames.mean(axis=0).astype(np.uint8))


def _make_pictures() -> None:
    rng = np.random.default_rng(0)
    lm.write_image("black.png", np.zeros((16, 16), np.uint8))
    lm.write_image("mask.png", np.full((16, 16), 255, np.uint8))
    lm.write_image("pattern.png", rng.integers(0, 256, (16, 16), np.uint8))
    colours = np.kron(rng.integers(60, 255, (6, 8, 3), np.uint8), np.ones((8, 8, 1), np.uint8))
    for name in ("picture.png", "picture.jpg", "wanted.png", "wanted.jpg", "frames/0.png"):
        Path(name).parent.mkdir(exist_ok=True)
        Image.fromarray(colours).save(name)
    with av.open("film.mp4", "w") as film:
        stream = film.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        film.mux(stream.encode(av.VideoFrame.from_ndarray(colours, "rgb24")))
        film.mux(stream.encode())
    # A scene at seven exposures through a gamma, and the projector's grey values.
    light = np.geomspace(0.002, 0.9, 24 * 32).reshape(24, 32)
    for k in range(7):
        shown = np.minimum(255 * (light * 2.0 ** (k - 3)) ** (1 / 2.2), 255)
        lm.write_image(f"exposures/{k}.png", np.rint(shown).astype(np.uint8))
        shown = 255 * ((k / 6) ** 1.8 * light) ** (1 / 2.2)
        lm.write_image(f"ramp/{k}.png", np.rint(shown).astype(np.uint8))


def _make_board() -> None:
    folder = Path("procam-calibration/sample_data")
    patterns = lm.make_patterns("graycode", (144, 192))
    for k, pose in enumerate(POSES):
        board_capture(board_rig(), pose, patterns).save(f"pose_{k}")
        shutil.copytree(f"pose_{k}/images", folder / f"capture_{k}")
    shutil.copytree("pose_0/patterns", folder / "graycode_pattern")


def _photographs_in_colour() -> None:
    shutil.rmtree("scene.zarr")
    for path in Path("photos").iterdir():
        frame = lm.read_image(path)
        shown = np.stack([frame, frame // 2, frame // 3], axis=-1)
        lm.write_image(path, shown, overwrite=True)


def _patterns_in_colour() -> None:
    capture = lm.simulate("l_objects", lm.colour_bernoulli((16, 16), 24), exposure=0.4)
    lm.estimate_colour(capture, check=False, output="scene")


def _patterns_in_grey() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (24, 16, 16)).astype(np.float32) / np.float32(
        255
    )
    lm.simulate("l_objects", lm.ImagePatterns(grey)).save("capture", overwrite=True)


def _patterns_of_stripes() -> None:
    stripes = lm.make_patterns("graycode", (16, 16), inverse=True)
    lm.simulate("l_objects", stripes, exposure=0.5).save("capture", overwrite=True)


def _poses_are_made_by_the_page() -> None:
    for k in range(len(POSES)):
        shutil.rmtree(f"pose_{k}")


# What a page takes for granted, unlike the others.
PREPARED = {
    "colour": _photographs_in_colour,
    "compensation": _patterns_in_colour,
    "response": _patterns_in_grey,
    "shape": _patterns_of_stripes,
    "real-photographs": _poses_are_made_by_the_page,
}


def _commands(script: str) -> Iterator[list[str]]:
    """The commands that a shell would run; it makes folders and links itself."""
    noted = "".join(f'{name}() {{ echo {name} "${{@@Q}}"; }}\n' for name in PROGRAMS.split())
    done = subprocess.run(
        ["bash", "-e"], input=noted + script, capture_output=True, text=True, check=True
    )
    return map(shlex.split, done.stdout.splitlines())


def _run(words: list[str]) -> None:
    if _not_run(shlex.join(words)):
        return
    assert words[0] == "lightmatrix", words
    for output in (words[k + 1] for k, word in enumerate(words[:-1]) if word in OUTPUTS):
        if Path(output).is_dir():
            shutil.rmtree(output)
        else:
            Path(output).unlink(missing_ok=True)
    assert main(words[1:]) == 0, shlex.join(words)


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
@pytest.mark.usefixtures("small_scenes", "unchecked")
@pytest.mark.parametrize("page", [name for name in PAGES if BLOCKS.search(PAGES[name].read_text())])
def test_a_page_runs(
    page: str,
    kitchen: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(shutil.copytree(kitchen, tmp_path / "page", symlinks=True))
    PREPARED.get(page, lambda: None)()
    text = PAGES[page].read_text()
    assert not re.search(r"^(?:```\n| {4})lightmatrix ", BLOCKS.sub("", text), flags=re.MULTILINE)
    names: dict[str, Any] = {}
    variables = ""
    for language, block in BLOCKS.findall(text):
        if language != "py":
            for large, small in SMALLER.items():
                block = re.sub(large, small, block)
        if language == "sh":
            for words in _commands(variables + block):
                _run(words)
            variables += "".join(re.findall(r"^\w+=.*\n", block, flags=re.MULTILINE))
        elif language == "py":
            test = doctest.DocTestParser().get_doctest(block, names, page, None, 0)
            assert doctest.DocTestRunner().run(test, clear_globs=False).failed == 0
            names.update(test.globs)
        elif _not_run(block):
            compile(block, page, "exec")
        else:
            exec(compile(block, page, "exec"), names)
    said = capsys.readouterr().out
    if page == "first-capture":
        assert "24 frames in capture" in said
        assert "the projector's gamma is 2.20" in said
    elif page == "picture-on-a-wall":
        # The camera sees more of the picture than as it is, and more again once it corrects.
        better, plain = map(float, re.findall(r"([0-9.]+) dB", said.split("photograph 0")[0]))
        assert better > plain + 5
