"""The estimate of memory and time, and the refusal of what cannot fit, with advice."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.cli.source import rectangle
from lightmatrix.estimators import resource_estimate
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.coherent.schedule import spacings
from lightmatrix.resources.threads import core_threads

GIB = 2**30


@dataclass(frozen=True)
class Unread:
    """Frames that must not be read."""

    count: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def read(self, index: int) -> NDArray[Any]:
        raise AssertionError(f"frame {index} was read")

    def name(self, index: int) -> str:
        return str(index)

    def select(self, index: Sequence[int]) -> Unread:
        return Unread(len(index), self.shape, self.dtype)


@pytest.fixture(scope="module")
def large() -> lm.Capture:
    """24 megapixels of 16 bits and a projector of 768 x 1024."""
    patterns = lm.BernoulliPatterns((768, 1024), 64)
    frames = Unread(64, (4000, 6000), np.dtype(np.uint16))
    return lm.Capture(patterns, frames, lm.Decoder(65535, 65535))


@pytest.fixture(autouse=True)
def _memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource_estimate, "available_bytes", lambda: 16 * GIB)
    monkeypatch.setattr(resource_estimate, "slowness", lambda: 1.0)
    monkeypatch.setenv("RAYON_NUM_THREADS", "2")


def test_what_cannot_fit_is_refused_before_any_frame_is_read(large: lm.Capture) -> None:
    resources = lm.estimate_resources(large)
    assert not resources.fits
    assert resources.memory > 19 * GIB
    assert resources.temporary == 24_000_000 * 64 * 2
    with pytest.raises(lm.InputError, match="24,000,000 camera samples") as refused:
        lm.estimate(large)
    assert "GiB of memory, 16 GiB are free" in refused.value.message
    assert "--bin-camera" in (refused.value.hint or "")


def test_what_is_proposed_fits(large: lm.Capture) -> None:
    advice = lm.estimate_resources(large).advice
    assert "--crop" in advice
    for cut in (large, large.crop((500, 1000), (3000, 4000))):
        for words, size in lm.estimate_resources(cut).options:
            smaller = cut
            if match := re.search(r"--crop (\S+)", words):
                smaller = large.crop(*rectangle(match[1]))
            if match := re.search(r"--bin-camera (\d+)", words):
                smaller = smaller.bin(camera=int(match[1]))
            assert smaller.rows == size.rows
            if "--bin-projector" not in words:  # Takes a while at this size.
                again = lm.estimate_resources(smaller)
                assert (again.fits, again.options) == (True, ())
                assert again.memory == size.memory


def test_a_proposal_bins_both_camera_and_projector() -> None:
    """The camera keeps about twice as many samples as the projector has pixels."""
    patterns = lm.BernoulliPatterns((768, 1024), 64)
    frames = Unread(64, (4001, 6001), np.dtype(np.uint16))
    capture = lm.Capture(patterns, frames, lm.Decoder(65535, 65535))
    options = dict(lm.estimate_resources(capture).options)
    (words,) = (words for words in options if "-camera" in words and "-projector" in words)
    camera, projector = (int(part) for part in re.findall(r" (\d+)", words))
    size = options[words]
    assert size.camera == (-(-4001 // camera), -(-6001 // camera))
    assert size.pixels == -(-768 // projector) * -(-1024 // projector)
    assert 1.5 < size.rows / size.pixels <= 2.1


def test_the_command_reports_and_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, store = tmp_path / "capture", tmp_path / "scene.zarr"
    lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16), exposure=0.4).save(folder)
    words = ["estimate", str(folder), "-o", str(store)]
    assert main([*words, "--dry-run"]) == 0
    assert "GiB" in capsys.readouterr().out
    assert main([*words, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fits"] is True
    assert not store.exists()
    monkeypatch.setattr(resource_estimate, "available_bytes", lambda: 100 << 20)
    assert main(words) == 2
    assert "are free" in capsys.readouterr().err
    assert not store.exists()
    # --no-check tries what the model refuses.
    assert main([*words, "--no-check", "--no-coherent", "--iterations", "2"]) == 0
    assert "this takes about" in capsys.readouterr().err


def test_other_solvers_have_no_time() -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16))
    resources = lm.estimate_resources(capture, lm.EstimateSettings(solver="saturation-admm"))
    assert resources.seconds is None
    assert resources.fits


@pytest.mark.parametrize("block", [3, (2, 5)])
def test_photographs_are_binned_in_strips(
    block: int | tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which changes nothing, whatever clips, is masked, or has a black level of its own."""
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure="0.9:0.5,0.2:0.5",
                          ambient=0.1)  # fmt: skip
    mask = np.random.default_rng(0).random((64, 64)) > 0.1
    mask[:10, :10] = False
    whole = lm.Capture(capture.patterns, capture.frames, capture.decoder, mask)
    expected = whole.bin(camera=block).samples()
    monkeypatch.setattr("lightmatrix.capture.reader._STRIP", 500)
    binned = whole.bin(camera=block).samples()
    assert expected.clipped.any()
    for name in ("values", "clipped", "clip_level", "weights"):
        np.testing.assert_array_equal(getattr(binned, name), getattr(expected, name))


def test_a_memory_limit_makes_tiles_smaller_and_is_kept() -> None:
    patterns = lm.BernoulliPatterns((256, 256), 64)
    capture = lm.Capture(patterns, Unread(64, (512, 512), np.dtype(np.uint8)), lm.Decoder(255, 255))
    usual = lm.estimate_resources(capture)
    for solver in ("active-set", "admm"):
        free = lm.EstimateSettings(solver=solver)
        most = lm.estimate_resources(capture, free).memory - (100 << 20)
        bounded = lm.EstimateSettings(solver=solver, memory=most)
        resources = lm.estimate_resources(capture, bounded)
        assert resources.fits
        assert resources.memory <= most
        assert resources.size.tile_bytes < usual.size.tile_bytes
        assert choose_estimator(capture, bounded).tile_rows == resources.size.tile_rows  # type: ignore[attr-defined]
    with pytest.raises(lm.InputError, match=r"0\.2 GiB are allowed") as refused:
        lm.estimate(capture, memory="0.2GiB")
    assert refused.value.hint
    # A limit above the free memory does not help.
    settings = lm.EstimateSettings(memory="1TiB")
    assert lm.estimate_resources(capture, settings).available == 16 * GIB


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"memory": "4 apples"}, "4 apples"),
        ({"memory": "GiB"}, "'GiB'"),
        ({"memory": 0}, "0 bytes"),
        ({"memory": "4GiB", "tile_rows": 5}, "tile rows and a memory limit"),
        ({"memory": "4GiB", "multi_scale": True}, "multi-scale"),
    ],
)
def test_bad_memory_limits(settings: dict[str, Any], what: str) -> None:
    with pytest.raises(lm.InputError, match=what):
        lm.EstimateSettings(**settings)


def test_large_frames_take_less_than_a_search_by_all_rows(large: lm.Capture) -> None:
    small = lm.Capture(large.patterns, Unread(64, (32, 32), large.frames.dtype), large.decoder)
    assert lm.estimate_resources(small).size.kind == "coherent"
    assert lm.estimate_resources(large).size.kind == "growing"
    seconds = [lm.estimate_resources(capture).seconds for capture in (small, large)]
    assert seconds[0] is not None
    assert seconds[1] is not None
    assert seconds[1] / large.rows < 0.1 * seconds[0] / small.rows


def test_small_cameras_under_huge_projectors() -> None:
    """They have too few camera pixels for seeds, so that all of them search."""

    def capture(rows: int, cols: int, *channels: int) -> lm.Capture:
        patterns = lm.BernoulliPatterns((1024, 1024), 32)
        frames = Unread(32, (rows, cols, *channels), np.dtype(np.uint8))
        return lm.Capture(patterns, frames, lm.Decoder(255, 255))

    seconds = {}
    for shape in ((48, 48), (48, 500), (64, 64), (64, 64, 3), (128, 128), (256, 256)):
        case = capture(*shape)
        resources = lm.estimate_resources(case)
        steps = spacings(case.camera_shape, case.patterns.pixels, lm.CoherentEstimator.windows)
        assert resources.size.kind == ("growing" if len(steps) > 1 else "coherent"), shape
        assert resources.seconds is not None
        seconds[shape] = resources.seconds
    assert seconds[48, 48] > 1.6 * seconds[64, 64]
    # The fewer rows are seeds, the less each row takes.
    each = [seconds[side, side] / side**2 for side in (48, 64, 128, 256)]
    assert each == sorted(each, reverse=True)
    # A proposal is judged by its own sides.
    proposed = dict(lm.estimate_resources(capture(400_000, 70)).options)
    binned = next(size for words, size in proposed.items() if words.startswith("--bin-camera"))
    assert binned.kind == "coherent"


@pytest.mark.parametrize("estimator", ["coherent", "plain"])
def test_a_tile_holds_as_many_rows_as_its_memory_does(estimator: str, large: lm.Capture) -> None:
    settings = lm.EstimateSettings(coherent=estimator == "coherent")
    size = lm.estimate_resources(large, settings).size
    taken = size.tile_rows * size.solved_row_bytes
    assert size.tile_bytes - size.solved_row_bytes < taken <= size.tile_bytes


def test_stripes_take_more() -> None:
    stripes = lm.GrayCodePatterns((512, 512))
    frames = Unread(stripes.count, (64, 64), np.dtype(np.uint8))
    sizes = [
        lm.estimate_resources(lm.Capture(patterns, frames, lm.Decoder(255, 255)))
        for patterns in (stripes, lm.BernoulliPatterns((512, 512), stripes.count))
    ]
    assert [each.size.striped for each in sizes] == [True, False]
    assert sizes[0].memory > sizes[1].memory
    assert (sizes[0].seconds or 0) > 1.3 * (sizes[1].seconds or 0)


def test_threads_of_the_core(monkeypatch: pytest.MonkeyPatch) -> None:
    for wanted, threads in (("3", 3), ("0", os.cpu_count()), ("", os.cpu_count()), ("x", None)):
        monkeypatch.setenv("RAYON_NUM_THREADS", wanted)
        assert core_threads() == (threads or os.cpu_count())


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (9.9, "a few seconds"),
        (10, "10 s"),
        (86, "90 s"),
        (90, "2 min"),
        (89.4 * 60, "89 min"),
        (90 * 60, "2 h"),
        (47 * 3600, "47 h"),
        (48 * 3600, "2 days"),
        (240 * 3600, "10 days"),
    ],
)
def test_words_for_times(seconds: float, words: str) -> None:
    assert resource_estimate._time(seconds) == words


def test_long_times_are_those_of_this_machine(
    large: lm.Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16))
    usual = [lm.estimate_resources(capture) for capture in (small, large)]
    monkeypatch.setattr(resource_estimate, "slowness", lambda: 3.0)
    slow = [lm.estimate_resources(capture) for capture in (small, large)]
    assert slow[0] == usual[0]
    assert slow[1].seconds == pytest.approx(3 * (usual[1].seconds or 0))
    options = slow[1].as_dict()["options"]
    assert options
    assert slow[1].advice != usual[1].advice
    cores = core_threads()
    for (_, size), option in zip(slow[1].options, options, strict=True):
        assert option["seconds"] == pytest.approx(3 * (size.seconds(cores) or 0))
        assert option["seconds"] <= 3600


def test_the_speed_of_this_machine_says_nothing_of_a_cluster(
    large: lm.Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource_estimate, "slowness", lambda: 3.0)
    settings = lm.EstimateSettings(cluster="tcp://127.0.0.1:8786")
    assert lm.estimate_resources(large, settings).slowness == 1


def test_words_for_memory() -> None:
    sizes = {3 * GIB // 2: "1.5 GiB", 9 * GIB: "9 GiB", 10 * GIB: "10 GiB", 2000 * GIB: "2,000 GiB"}
    for size, words in sizes.items():
        assert resource_estimate._gigabytes(size) == words
    assert resource_estimate._block((1, 1), 4) == "4"
    assert resource_estimate._block((2, 3), 4) == "8x12"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize(
    ("grey", "crop", "most"),
    [
        (False, None, 1.3),
        (True, None, 1.3),
        # Grey frames that are cropped: measured .99 and 1.00.
        (True, ((4, 4), (12, 12)), 1.1),
        (True, ((0, 0), (20, 22)), 1.1),
    ],
)
def test_an_estimate_takes_hardly_more_memory_than_was_said(
    tmp_path: Path, grey: bool, crop: tuple[tuple[int, int], tuple[int, int]] | None, most: float
) -> None:
    patterns: lm.PatternSet = lm.BernoulliPatterns((160, 160), 46)
    if grey:
        levels = np.random.default_rng(0).integers(0, 256, (46, 160, 160)) / 255
        patterns = lm.ImagePatterns(levels.astype(np.float32))
    truth = lm.ProceduralScene((24, 24), (160, 160), seed=1).truth()
    lm.simulate(truth, patterns, exposure=0.5, noise=0.003).save(tmp_path / "capture")
    program = (
        "import sys; import lightmatrix as lm\n"
        f"capture = lm.Capture.open(sys.argv[1], crop={crop})\n"
        "said = lm.estimate_resources(capture).memory\n"
        "lm.estimate(capture, check=False)\n"
        # Not `ru_maxrss`, which begins with that of the process of the tests.
        "status = open('/proc/self/status').read()\n"
        "print(1024 * int(status.split('VmHWM:')[1].split()[0]) / said)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "capture")]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(ran.stdout) < most
