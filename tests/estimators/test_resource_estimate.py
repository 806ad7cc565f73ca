"""The bound on memory, the order of magnitude of the time, and the refusal of what cannot fit."""

from __future__ import annotations

import json
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
from lightmatrix.estimators import resource_estimate

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
    monkeypatch.setenv("RAYON_NUM_THREADS", "2")


def test_what_cannot_fit_is_refused_before_any_frame_is_read(large: lm.Capture) -> None:
    resources = lm.estimate_resources(large)
    assert not resources.fits
    assert resources.memory > 19 * GIB
    assert resources.temporary == 24_000_000 * 64 * 2
    with pytest.raises(lm.InputError, match="GiB of memory, 16 GiB are free") as refused:
        lm.estimate(large)
    assert "bin_camera=2" in (refused.value.hint or "")
    assert lm.estimate_resources(large.bin(camera=2)).fits


def test_the_command_reports_and_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, store = tmp_path / "capture", tmp_path / "scene.zarr"
    lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16), exposure=0.4).save(folder)
    words = ["estimate", str(folder), "-o", str(store)]
    assert main([*words, "--dry-run"]) == 0
    assert "GiB are free" in capsys.readouterr().out
    assert main([*words, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fits"] is True
    assert not store.exists()
    monkeypatch.setattr(resource_estimate, "available_bytes", lambda: 100 << 20)
    assert main(words) == 2
    assert "are free" in capsys.readouterr().err
    assert not store.exists()


def test_other_solvers_have_no_time() -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16))
    resources = lm.estimate_resources(capture, lm.EstimateSettings(solver="saturation-admm"))
    assert resources.seconds is None
    assert resources.fits


@pytest.mark.parametrize("solver", ["active-set", "admm"])
def test_a_memory_limit_makes_tiles_smaller_and_is_kept(solver: str) -> None:
    patterns = lm.BernoulliPatterns((256, 256), 64)
    capture = lm.Capture(patterns, Unread(64, (512, 512), np.dtype(np.uint8)), lm.Decoder(255, 255))
    usual = lm.estimate_resources(capture, lm.EstimateSettings(solver=solver))
    bounded = lm.EstimateSettings(solver=solver, memory=usual.memory - (100 << 20))
    resources = lm.estimate_resources(capture, bounded)
    assert resources.fits
    assert resources.tile_rows < usual.tile_rows
    with pytest.raises(lm.InputError, match=r"205 MiB are allowed"):
        lm.estimate(capture, solver=solver, memory="0.2GiB")
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
    seconds = [lm.estimate_resources(capture).seconds for capture in (small, large)]
    assert seconds[0] is not None
    assert seconds[1] is not None
    assert seconds[1] / large.rows < 0.1 * seconds[0] / small.rows


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize(("grey", "crop"), [(True, None), (False, ((4, 4), (12, 12)))])
def test_an_estimate_takes_no_more_memory_than_its_bound(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    grey: bool,
    crop: tuple[tuple[int, int], tuple[int, int]] | None,
) -> None:
    # What the allocator keeps for threads that have ended is not the estimate's. On a busy machine
    # more of them wait at once, and took 60 MiB more; commands limit their number alike.
    monkeypatch.setenv("MALLOC_ARENA_MAX", "2")
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
    assert float(ran.stdout) <= 1


def test_a_large_projector_is_not_held_as_a_whole() -> None:
    """From 2^20 pixels on, atoms are made where they are needed; a limit makes fewer at a time."""
    frames = Unread(16, (256, 256), np.dtype(np.uint8))
    taken = []
    for rows in (1000, 1100):
        patterns = lm.BernoulliPatterns((rows, 1000), 16)
        capture = lm.Capture(patterns, frames, lm.Decoder(255, 255))
        taken.append(lm.estimate_resources(capture).memory)
    assert taken[1] < 0.7 * taken[0]
    bounded = lm.EstimateSettings(memory=taken[1] - (200 << 20))
    assert lm.estimate_resources(capture, bounded).fits
