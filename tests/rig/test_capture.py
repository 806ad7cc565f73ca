"""Whole captures by a virtual rig: what they contain, and how they resume."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.rig.devices.virtual import VirtualCamera
from lightmatrix.rig.rig import ProjectedPatterns
from lightmatrix.rig.session import Step
from tests.helpers.systems import SIGNALS

from .faulty_rig import USUAL, faulty_rig
from .rig_faults import run, wrong_frames
from .small_disk import small_disk

QUIET = "virtual:procedural,size=24,real=0"


@pytest.fixture(scope="module")
def _known() -> lm.RigMeasurements:
    with lm.open_rig(QUIET) as rig:
        return lm.measure_rig(rig)


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, _known: lm.RigMeasurements) -> None:
    """A folder that has measurements of the quiet rig; other rigs are measured."""
    monkeypatch.chdir(tmp_path)
    _known.save("rig.json")


def _capture(words: str = "", **arguments: Any) -> lm.Capture:
    """A capture by the quiet rig with other words; settings stand among the arguments."""
    names = [field.name for field in fields(lm.CaptureSettings) if field.name in arguments]
    settings = lm.CaptureSettings(**{name: arguments.pop(name) for name in names})
    with faulty_rig(QUIET + words) as rig:
        return lm.take_capture("capture", rig, **{"count": 32, "settings": settings, **arguments})


class _StopError(Exception):
    pass


def _stop_after(frames: int, **arguments: Any) -> None:
    """Begin a capture, and stop it."""

    def progress(step: Step) -> None:
        if step.done == frames:
            raise _StopError

    with pytest.raises(_StopError):
        _capture(progress=progress, **arguments)


def test_a_measured_curve_goes_with_the_capture(tmp_path: Path) -> None:
    curve = tmp_path / "curve.txt"
    curve.write_text("0 0\n1 1\n")
    with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
        settings = lm.CaptureSettings(response=f"curve:{curve}")
        lm.take_capture(tmp_path / "taken", rig, count=20, settings=settings)
    curve.unlink()
    assert lm.Capture.open(tmp_path / "taken").decoder.response.name == "curve:curve.txt"


def test_a_capture_is_as_good_as_a_simulated_one() -> None:
    with faulty_rig(QUIET + USUAL) as rig:
        capture = lm.take_capture("capture", rig)
    errors = lm.evaluate(lm.estimate(capture, check=False), "capture/truth.npz")
    truth = lm.truth("capture/truth.npz")
    # The simulated capture has the same room light, which its black frame removes.
    simulated = lm.simulate(
        truth, capture.patterns, exposure=1.0, bits=12, black_level=64, ambient=0.02
    )
    known = lm.evaluate(lm.estimate(simulated, check=False), truth)
    assert errors.relighting_error < 1.05 * known.relighting_error
    assert errors.relative_error < 1.05 * known.relative_error


def test_a_capture_states_how_it_was_taken() -> None:
    capture = _capture()
    description = json.loads(Path("capture/capture.json").read_text())
    assert description["clip"] == 4095
    assert description["black_level"] == pytest.approx(64, abs=1)
    assert description["exposure"] == description["black"]["exposure"] == 1
    assert capture.provenance["checked"]
    assert capture.provenance["photographed_again"] == {}
    assert not Path("capture.partial").exists()
    assert not [path for path in Path().iterdir() if path.name.startswith(".")]
    # The rig is known now, and only the exposures of the scene are measured again.
    before = lm.RigMeasurements.load("rig.json")
    _capture(",seed=1", overwrite=True)
    after = lm.RigMeasurements.load("rig.json")
    assert after.exposure != before.exposure
    assert replace(after, exposure=before.exposure) == before


def test_grey_patterns_are_shown_as_their_light() -> None:
    draw = np.random.default_rng(0)
    grey = lm.ImagePatterns(draw.random((40, 24, 24), np.float32))
    with lm.open_rig(QUIET + ",gamma=2.4,noise=0.001") as rig:
        capture = lm.take_capture("capture", rig, grey)
    seen = capture.samples().values
    light = lm.truth("capture/truth.npz").matrix @ grey.dense().T
    assert np.linalg.norm(seen - light) < 0.01 * np.linalg.norm(light)


def test_cells_are_shown_in_the_middle_of_the_screen() -> None:
    capture = _capture(",size=16", cell=3)
    assert capture.projector_shape == (5, 5)
    assert not Path("capture/truth.npz").exists()
    with pytest.raises(lm.InputError, match="for a projector of 16 x 16"):
        _capture(",size=16", patterns=lm.BernoulliPatterns((16, 16), 20), cell=2, overwrite=True)


def test_several_exposures_where_the_light_asks_for_them() -> None:
    capture = _capture(",noise=0.03,bits=8,black=4")
    assert len(np.unique(capture.exposures)) > 1
    assert capture.exposures.max() == pytest.approx(1)


def test_a_camera_whose_exposure_is_set_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(camera: VirtualCamera, seconds: float) -> None:
        raise lm.DeviceError("its exposure cannot be set from here")

    fixed = property(lambda camera: 0.007, refuse)
    info = VirtualCamera.info
    monkeypatch.setattr(VirtualCamera, "exposure", fixed)
    monkeypatch.setattr(
        VirtualCamera,
        "info",
        lambda camera: {**info(camera), "shortest_exposure": 0.007, "longest_exposure": 0.007},
    )
    capture = _capture(",unit=0.014")
    assert capture.provenance["exposure_1_in_seconds"] == 0.007


# ---- faults


@pytest.mark.parametrize(
    ("fault", "least"),
    [
        (",late=0.2", 3),
        (",late=0.2,fps=0", 3),
        (",dropped=0.2,fps=0", 3),
        (",duplicate=0.2,fps=0", 3),
        (",torn=0.2,fps=0", 3),
        (",torn=0.3,delay=0.5", 0),
        (",unplugged=5,unplugged_at=6,fps=0", 1),
        (",altered=2,altered_at=6,fps=0", 1),
    ],
)
def test_faults_are_noticed_and_frames_repeated(fault: str, least: int) -> None:
    provenance = _capture(fault, settle=0.05).provenance
    assert not provenance["left_out"]
    assert provenance["frames"] == provenance["patterns"]
    assert sum(provenance["photographed_again"].values()) >= least
    _right_frames(fault)


def _right_frames(words: str) -> None:
    """Each frame is what its pattern alone gives, pixel by pixel."""
    assert wrong_frames(lm.Capture.open("capture"), faulty_rig(QUIET + words)) == []


def test_patterns_that_always_fail_are_named_and_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    image = ProjectedPatterns.image

    def stubborn(self: ProjectedPatterns, index: int) -> Any:
        # Two patterns never come out right: something else is shown each time.
        if index in (7, 20):
            return np.random.default_rng().integers(0, 2, self.screen, np.uint8) * np.uint8(255)
        return image(self, index)

    with monkeypatch.context() as patched:
        patched.setattr(ProjectedPatterns, "image", stubborn)
        with pytest.warns(lm.LightMatrixWarning, match=r"2 patterns are left out.*pattern 7"):
            capture = _capture(",fps=0")
    assert sorted(capture.provenance["left_out"]) == ["20", "7"]
    assert capture.count == 30
    _right_frames(",fps=0")
    assert lm.Capture.open("capture").count == 30


def test_several_failures_in_a_row_end_the_session() -> None:
    _stop_after(10)
    with pytest.raises(lm.DeviceError, match=r"32 photographs in a row.* differ") as caught:
        # Each picture comes later than was measured.
        _capture(",delay=20,fps=0")
    assert "the frames so far are kept" in str(caught.value.hint)
    assert _capture().count == 32


def test_a_room_whose_light_varies_is_named() -> None:
    with lm.open_rig(QUIET) as rig:
        known = lm.measure_rig(rig)
    assert known.flicker is not None
    replace(known, flicker=replace(known.flicker, room=0.05)).save("rig.json")
    with pytest.warns(lm.LightMatrixWarning, match="room's light varies by 5 % of white"):
        _capture(count=4)


@pytest.mark.parametrize("seed", range(2))
def test_captures_are_right_despite_kills_full_disks_and_faults(seed: int, tmp_path: Path) -> None:
    outcome = run(tmp_path, seed, count=32, kills=2)
    assert outcome.wrong == []
    assert outcome.left_out == 0


# ---- going on


def test_a_capture_that_was_stopped_goes_on() -> None:
    _stop_after(20)
    assert not Path("capture").exists()
    kept = {path.name: path.read_bytes() for path in Path("capture.partial").glob("image_*")}
    assert len(kept) == 20
    steps: list[int] = []
    capture = _capture(progress=lambda step: steps.append(step.done))
    assert steps[0] == 21
    assert capture.count == 32
    assert all(Path("capture/images", name).read_bytes() == kept[name] for name in kept)
    assert not Path("capture.partial").exists()


def test_a_damaged_frame_is_taken_again() -> None:
    _stop_after(20)
    file = Path("capture.partial/image_0003.tif")
    file.write_bytes(file.read_bytes()[:100])
    steps: list[int] = []
    assert _capture(progress=lambda step: steps.append(step.done)).count == 32
    assert len(steps) == 13
    _right_frames("")


def test_frames_of_another_capture_are_not_mixed_in() -> None:
    _stop_after(20)
    with pytest.raises(lm.OutputError, match=r"frames of another capture.*different patterns"):
        _capture(seed=1)
    assert _capture(seed=1, overwrite=True).count == 32


@pytest.mark.parametrize(
    ("first", "then", "words"),
    [
        ({"exposure": 0.01}, {"exposure": 0.02}, "exposure was 0.01, is 0.02"),
        ({"exposure": 0.01}, {}, "exposure was 0.01, is not given"),
        ({}, {"exposure": 0.01}, "exposure was not given, is 0.01"),
        ({"cell": 2}, {"cell": 1}, "cell was 2, is 1; different patterns"),
        ({"words": ",bits=10,black=16"}, {}, "the camera: bits was 10, is 12"),
    ],
)
def test_changed_settings_are_named(
    first: dict[str, Any], then: dict[str, Any], words: str
) -> None:
    common = {"settle": 0.05, "keep": None}
    _stop_after(2, **{**common, **first})
    with pytest.raises(lm.OutputError, match="holds frames of another capture") as caught:
        _capture(**{**common, **then})
    assert f"({words})" in caught.value.message
    assert "those settings" in str(caught.value.hint)


def test_a_moved_rig_is_refused() -> None:
    _stop_after(20)
    with pytest.raises(lm.DeviceError, match="since the first 20 frames") as caught:
        _capture(",seed=8", settle=0.05)
    assert "overwrite=True" in str(caught.value.hint)
    assert _capture().count == 32


def test_a_capture_that_failed_at_once_leaves_nothing() -> None:
    with pytest.raises(lm.DeviceError):
        _capture(",unit=1e6,room=0")
    assert not list(Path().glob("*capture*"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "there is no rig"),
        ("--rig virtual:metal --camera aravis", "one or the other"),
        ("--rig real", "write virtual:SCENE"),
        (f"--rig {QUIET} --exposure 0", "an exposure of 0 s"),
        (f"--rig {QUIET} --settle -1", "a settle time of -1"),
        (f"--rig {QUIET} --cell 0", "a cell of 0"),
        (f"--rig {QUIET} --response gama", "gama"),
        (f"--rig {QUIET},room=1 --exposure 2", "a white picture looks like a black one"),
    ],
)
def test_wrong_options_are_refused(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "-o", "capture", *words.split()]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert not list(Path().glob("*capture*"))


@pytest.mark.usefixtures("unchecked")
def test_one_command_photographs_and_estimates(capsys: pytest.CaptureFixture[str]) -> None:
    line = f"capture --rig {QUIET} -k 32 -o capture --estimate scene.zarr --json"
    assert main(line.split()) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"] == 32
    assert summary["estimate"]["output"] == "scene.zarr"
    assert main(["evaluate", "scene.zarr", "--truth", "capture/truth.npz"]) == 0
    assert main(line.split()) == 2
    assert "exists already" in capsys.readouterr().err


@SIGNALS
def test_ctrl_c_keeps_the_frames() -> None:
    # Measuring the rig in real time would take long.
    with lm.open_rig(QUIET) as rig:
        lm.measure_rig(rig, ["settle", "flicker", "response"], keep="rig.json")
    # Shells ignore this signal for programs in their background.
    started = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from lightmatrix.cli import console; console()"
    )
    # The capture must be slow enough to be interrupted on any machine.
    real = QUIET.replace("real=0", "real=1")
    words = f"capture --rig {real},fps=0 -k 40 --exposure 0.01 --settle 0.2 -o capture"
    process = subprocess.Popen(
        [sys.executable, "-c", started, *words.split()], stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120
    while not Path("capture.partial/image_0002.tif").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert errors == "stopped; finished frames are kept, run again to continue\n"
    with lm.open_rig(QUIET) as rig:
        settings = lm.CaptureSettings(exposure=0.01, settle=0.2)
        capture = lm.take_capture("capture", rig, count=40, settings=settings)
    assert capture.count == 40


def test_a_capture_goes_on_when_a_full_disk_has_room_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path) as disk:
        if disk is None:
            pytest.skip("no disk can be mounted: not root, or not allowed")
        settings = "-k 24 --settle 0.05 --exposure 0.02 --seed 3"
        files = f"-o {tmp_path / 'capture'} --rig-file {tmp_path / 'rig.json'}"
        words = f"capture --rig {QUIET.replace('24', '16')},fps=0 {settings} {files}".split()
        # None at all, and enough for some frames, twice.
        kept = []
        for room in (0, 40 << 10, 24 << 10):
            disk.leave(room)
            assert main(words) == 2
            errors = capsys.readouterr().err
            assert "No space left on device" in errors
            assert "Traceback" not in errors
            assert not (tmp_path / "capture").exists()
            kept.append(len(list(tmp_path.glob("capture.partial/image_*.tif"))))
        assert 0 == kept[0] < kept[1] <= kept[2]
        disk.free()
        assert main(words) == 0
        assert lm.Capture.open(tmp_path / "capture").count == 24
        assert not list(tmp_path.glob("*partial*"))
