"""The virtual rig shows what it should, and fails at the rates that it is given."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.protocols import Camera, Projector
from lightmatrix.live.devices.virtual.projector import VirtualProjector
from lightmatrix.live.devices.virtual.settings import parse_settings
from lightmatrix.live.rig import Rig, open_rig

from .contract import CameraContract, ProjectorContract

QUIET = "virtual:procedural,size=12,late=0,dropped=0,duplicate=0,torn=0"
_SIMULATED = f"{QUIET},real=0"


class TestTriggered(CameraContract):
    @pytest.fixture
    def camera(self) -> Camera:
        return open_rig(f"{QUIET},fps=0").camera


class TestFreeRunning(CameraContract):
    triggered = False

    @pytest.fixture
    def camera(self) -> Camera:
        return open_rig(f"{QUIET},fps=100").camera


class TestProjector(ProjectorContract):
    def shown(self, projector: Projector) -> NDArray[np.uint8]:
        assert isinstance(projector, VirtualProjector)
        assert projector.image is not None
        image = projector.image
        return image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)

    @pytest.fixture
    def projector(self) -> Projector:
        return open_rig(QUIET).projector


def _white(rig: Rig) -> NDArray[np.uint8]:
    return np.full(rig.projector.shape, 255, np.uint8)


def test_the_light_changes_when_it_should_and_as_t_says() -> None:
    rig = open_rig(f"{_SIMULATED},delay=3,fps=0,noise=0,gamma=2,leak=0,room=0")
    rig.camera.exposure = 0.005
    grey = np.full(rig.projector.shape, 128, np.uint8)
    shown = rig.projector.show(grey)
    levels = []
    while rig.clock.now() < shown + 0.1:
        rig.camera.trigger()
        frame = rig.camera.get_image(1)
        levels.append((frame.timestamp - 0.005 - shown, float(frame.data.mean())))
    assert rig.truth is not None
    light = 0.25 * (128 / 255) ** 2 * rig.truth.matrix.sum(axis=1)
    expected = 64 + np.minimum(light, 1).mean() * (4095 - 64)
    for start, level in levels:
        if start >= 3 / 60:
            assert level == pytest.approx(expected, abs=0.5)
        elif start < 3 / 60 - 0.005:
            assert level == pytest.approx(64, abs=0.5)


def test_frames_grow_stale_in_the_buffers_of_a_camera_that_runs_freely() -> None:
    rig = open_rig(f"{_SIMULATED},fps=30,buffers=3,delay=0")
    rig.clock.sleep(1)
    shown = rig.projector.show(_white(rig))
    rig.clock.sleep(0.2)
    stale = [rig.camera.get_image(1) for _ in range(3)]
    assert all(frame.timestamp < shown for frame in stale)
    rig.camera.flush()
    assert rig.camera.get_image(1).timestamp > shown


def test_flicker_is_averaged_over_the_exposure() -> None:
    rig = open_rig(f"{_SIMULATED},fps=0,flicker=0.1,noise=0,room=0,delay=0,leak=0")
    rig.projector.show(_white(rig))
    rig.clock.sleep(0.1)
    spreads = []
    for exposure in (0.001, 0.01):
        rig.camera.exposure = exposure
        levels = []
        for _ in range(40):
            rig.clock.sleep(0.00137)
            rig.camera.trigger()
            levels.append(rig.camera.get_image(1).data.mean() - 64)
        spreads.append((max(levels) - min(levels)) / 2 / np.mean(levels))
    assert spreads[0] == pytest.approx(0.1, rel=0.05)
    assert spreads[1] < 0.003


@pytest.mark.parametrize(("fault", "rate"), [("dropped", 0.2), ("duplicate", 0.2), ("torn", 0.2)])
def test_frames_fail_at_the_rate_asked_for(fault: str, rate: float) -> None:
    rig = open_rig(f"{_SIMULATED},fps=0,{fault}={rate}")
    last = rig.camera.get_image
    failed = 0
    before = None
    for _ in range(400):
        rig.camera.trigger()
        try:
            frame = last(0.5)
        except FrameTimeoutError:
            failed += 1
            continue
        if before is not None:
            failed += bool((frame.data[-1] == before.data[-1]).all())
        before = frame
    assert failed / 400 == pytest.approx(rate, abs=0.06)


def test_a_camera_that_is_unplugged_comes_back() -> None:
    rig = open_rig(f"{_SIMULATED},unplugged=5,unplugged_at=1")
    rig.camera.get_image(1)
    rig.clock.sleep(1)
    with pytest.raises(DeviceError, match="is gone"):
        rig.camera.get_image(1)
    rig.recover()
    assert 6 <= rig.clock.now() < 8
    assert rig.camera.get_image(1).timestamp > 6


def test_another_program_changes_the_exposure() -> None:
    rig = open_rig(f"{_SIMULATED},meddled=3,meddled_at=1")
    rig.camera.exposure = 0.004
    assert rig.camera.exposure == pytest.approx(0.004)
    rig.clock.sleep(1.1)
    assert rig.camera.exposure == pytest.approx(0.012)


def test_time_passes_as_it_does_unless_it_is_simulated() -> None:
    rig = open_rig(f"{QUIET},fps=0")
    started = time.monotonic()
    rig.camera.exposure = 0.05
    rig.camera.trigger()
    rig.camera.get_image(1)
    assert 0.05 <= time.monotonic() - started < 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("l_objects", "write virtual:SCENE"),
        ("virtual:", "write virtual:SCENE"),
        ("virtual:metal,speed=3", "it has size, refresh"),
        ("virtual:metal,late=often", "late=1"),
        ("virtual:metal,late=2", "from 0 to 1"),
        ("virtual:metal,late=nan", "from 0 to 1"),
        ("virtual:metal,bits=12.5", "whole number"),
        ("virtual:metal,bits=11", "8, 10, 12, 16"),
        ("virtual:no such scene", "no scene called"),
    ],
)
def test_what_is_no_virtual_rig(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        open_rig(text)
    assert words in str(caught.value)


def test_settings_are_read() -> None:
    settings = parse_settings("virtual:metal,delay=3,bits=8,late=0.5")
    assert (settings.scene, settings.delay, settings.bits, settings.late) == ("metal", 3, 8, 0.5)
