"""Measurements of virtual rigs agree with their settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.rig.rig import Rig
from lightmatrix.rig.rig_measurements import PARTS

from .faulty_rig import USUAL, faulty_rig

_RIG = "virtual:procedural,size=12,real=0" + USUAL


def _rig(words: str = "") -> Rig:
    return faulty_rig(_RIG + words)


def _measured(rig: Rig, part: str) -> Any:
    return getattr(lm.measure_rig(rig, [part]), part)


@pytest.mark.parametrize("fps", [0, 30, 29.97])
@pytest.mark.parametrize("delay", range(6))
def test_the_settle_time_is_found_within_a_refresh(delay: int, fps: float) -> None:
    settle = _measured(_rig(f",fps={fps},delay={delay},seed={delay}"), "settle")
    assert delay / 60 <= settle.seconds <= (delay + 1) / 60
    assert settle.unsettled <= settle.seconds


def test_occasional_late_images_do_not_lengthen_the_settle_time() -> None:
    settle = _measured(_rig(",fps=0,delay=2,late=0.07,seed=3"), "settle")
    assert 2 / 60 <= settle.seconds <= 3 / 60


def test_a_rig_slower_than_the_usual_wait_is_measured_with_the_stated_one(tmp_path: Path) -> None:
    slow, file = ",fps=0,delay=40", tmp_path / "rig.json"
    settings = lm.CaptureSettings(settle=0.8, check=False)
    for _ in range(2):
        # The second capture measures the exposures again, with the stated wait too.
        made = lm.take_capture(
            tmp_path / "c", _rig(slow), count=4, settings=settings, keep=file, overwrite=True
        )
        assert made.count == 4
    # Later commands use the stated time of rig.json.
    assert lm.measure_rig(_rig(slow), ["response"], keep=file).response is not None


def test_a_picture_that_never_settles() -> None:
    with pytest.raises(lm.DeviceError, match="does not see the projector"):
        _measured(_rig(",fps=0,delay=40"), "settle")


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 2.6])
def test_the_projectors_gamma_is_found(gamma: float) -> None:
    response = _measured(_rig(f",gamma={gamma},seed=1"), "response")
    assert response.gamma == pytest.approx(gamma, rel=0.02)
    # The inverse gives the light that is asked for, as well as 8 bits can.
    wanted = np.linspace(0, 1, 100)
    shown = (response.grey_for(wanted) / 255) ** gamma
    np.testing.assert_allclose(shown, wanted, atol=0.012)


def test_the_projectors_gamma_is_found_through_that_of_a_webcam() -> None:
    with lm.open_rig("virtual:procedural,size=16,real=0,bits=8,black=0,camera_gamma=2.2") as rig:
        known = lm.measure_rig(rig, ["response"], response="gamma:2.2")
    assert known.response is not None
    assert known.response.gamma == pytest.approx(2.2, abs=0.1)


def test_a_response_that_is_no_power() -> None:
    levels = tuple(range(0, 256, 15))
    light = np.array(levels) / 255
    bent = 3 * light**2 - 2 * light**3
    response = ProjectorResponse(levels, tuple(map(float, bent)), 1.7)
    grey = response.grey_for(np.array([0, 0.5, 1])).tolist()
    assert grey == [0, 128, 255] or grey == [0, 127, 255]


@pytest.mark.parametrize("fps", [0, 30])
def test_flicker_is_noticed_and_avoided(fps: float) -> None:
    rig = _rig(f",flicker=0.1,flicker_hz=100,fps={fps}")
    flicker = _measured(rig, "flicker")
    assert flicker.frequency == 100
    assert flicker.amplitude == pytest.approx(0.1, rel=0.1)
    advice = _measured(rig, "exposure")
    for seconds in advice.seconds:
        assert seconds * 100 == pytest.approx(round(seconds * 100), abs=1e-3)


def test_a_room_whose_light_varies() -> None:
    # A sine's standard deviation is 0.71 of its amplitude; a short exposure averages little of it.
    flicker = _measured(_rig(",room=0.1,room_flicker=0.5,fps=0"), "flicker")
    assert flicker.room == pytest.approx(0.71 * 0.5 * 0.1, rel=0.3)
    # White pictures flicker with it, and exposures of whole periods are rid of it.
    assert flicker.frequency == 100


def test_no_flicker_where_there_is_none() -> None:
    for seed in range(5):
        flicker = _measured(_rig(f",fps=0,seed={seed}"), "flicker")
        assert flicker.amplitude == flicker.frequency == 0
        assert flicker.spread < 0.005


def test_the_brightest_single_response_does_not_clip() -> None:
    rig = _rig(",black=200,bits=12")
    advice = _measured(rig, "exposure")
    assert advice.pedestal == pytest.approx(200, abs=1)
    assert advice.noise == pytest.approx(0.003, rel=0.1)
    assert rig.truth is not None
    single = rig.truth.matrix.max(axis=1).toarray().max()
    assert single * min(advice.seconds) / rig.unit < 1
    # But white is near to it.
    white = rig.truth.matrix.sum(axis=1)
    assert 0.8 < np.quantile(white, 0.99) * min(advice.seconds) / rig.unit < 1.2


def test_exposures_that_the_camera_does_not_have(monkeypatch: pytest.MonkeyPatch) -> None:
    advised = _measured(_rig(), "exposure")
    assert advised.warnings == ()
    monkeypatch.setattr(
        "lightmatrix.rig.rig_measurements.advise_exposures", lambda *_: [(30.0, 0.5), (2e-6, 0.5)]
    )
    limited = _measured(_rig(), "exposure")
    assert limited.seconds == (10.0, 20e-6)
    assert ["is 10 s" in limited.warnings[0], "is 2e-05 s" in limited.warnings[1]] == [True, True]


def test_a_camera_that_does_not_see_the_projector() -> None:
    for part in PARTS:
        with pytest.raises(lm.DeviceError, match="does not see the projector"):
            lm.measure_rig(_rig(",unit=1e6,room=0"), [part])


def test_a_scene_that_is_too_bright() -> None:
    with pytest.raises(lm.DeviceError, match="clips even at the camera's shortest exposure"):
        lm.measure_rig(_rig(",unit=0.000001"), ["exposure"])


def test_measurements_are_kept_and_used(tmp_path: Path) -> None:
    file = tmp_path / "rig.json"
    first = lm.measure_rig(_rig(), keep=file)
    assert lm.RigMeasurements.load(file) == first
    # Only what is asked for is measured again.
    second = lm.measure_rig(_rig(",seed=5"), ["exposure"], keep=file)
    assert second.response == first.response
    assert second.exposure != first.exposure
    # Measurements of another rig are not used.
    other = lm.measure_rig(lm.open_rig("virtual:procedural,size=10,real=0"), ["settle"], keep=file)
    assert other.response is None
    with pytest.raises(lm.InputError, match="measuring 'gamma'"):
        lm.measure_rig(_rig(), ["gamma"])
    with pytest.raises(lm.InputError, match="settle time of -1"):
        lm.measure_rig(_rig(), settle=-1)


def test_a_rigs_two_files_are_not_taken_for_each_other(tmp_path: Path) -> None:
    geometry = lm.truth("corner").geometry
    assert geometry is not None
    measured, lines = lm.RigMeasurements({}, {}), tmp_path / "geometry.json"
    geometry.save(lines)
    measured.save(tmp_path / "rig.json")
    with pytest.raises(lm.InputError, match=r"rig\.json: is not a lightmatrix-geometry") as refused:
        lm.triangulate(lm.truth("corner").transport(), tmp_path / "rig.json")
    assert "`lightmatrix calibrate`" in str(refused.value.hint)
    with pytest.raises(lm.InputError, match=r"geometry\.json: is not a lightmatrix-rig"):
        lm.measure_rig(_rig(), ["settle"], keep=lines)
    with pytest.raises(lm.OutputError, match="not written by lightmatrix as geometry"):
        geometry.save(tmp_path / "rig.json", overwrite=True)
    with pytest.raises(lm.OutputError, match="not written by lightmatrix as measurements"):
        measured.save(lines)


@pytest.mark.parametrize(
    ("key", "value"),
    [("settle", {"seconds": 1}), ("settle", 3), ("exposure", {}), ("projector", 5)],
)
def test_a_damaged_file(key: str, value: object, tmp_path: Path) -> None:
    file = tmp_path / "rig.json"
    known = lm.measure_rig(_rig(), ["settle"])
    file.write_text(json.dumps({**known.as_dict(), key: value}))
    with pytest.raises(lm.InputError, match=r"rig\.json: is damaged") as caught:
        lm.measure_rig(_rig(), ["settle"], keep=file)
    assert "remove it" in str(caught.value.hint)
