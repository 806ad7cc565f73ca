"""The virtual rig shows what it should, when it should."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Camera, Projector
from lightmatrix.rig.devices.virtual import HARDWARE, VirtualProjector
from lightmatrix.rig.rig import Rig, open_rig

from .contract import CameraContract, ProjectorContract
from .faulty_rig import faulty_rig

REAL = "virtual:procedural,size=12"
SIMULATED = f"{REAL},real=0"


class TestTriggered(CameraContract):
    @pytest.fixture
    def camera(self) -> Camera:
        return open_rig(f"{REAL},fps=0").camera


class TestFreeRunning(CameraContract):
    triggered = False

    @pytest.fixture
    def camera(self) -> Camera:
        return open_rig(f"{REAL},fps=100").camera


class TestProjector(ProjectorContract):
    def shown(self, projector: Projector) -> NDArray[np.uint8]:
        assert isinstance(projector, VirtualProjector)
        assert projector.image is not None
        image = projector.image
        return image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)

    @pytest.fixture
    def projector(self) -> Projector:
        return open_rig(REAL).projector


def _white(rig: Rig) -> NDArray[np.uint8]:
    return np.full(rig.projector.shape, 255, np.uint8)


def test_the_light_changes_when_it_should_and_as_t_says() -> None:
    rig = open_rig(f"{SIMULATED},delay=3,fps=0,noise=0,gamma=2,room=0")
    rig.camera.exposure = 0.005
    shown = rig.projector.show(np.full(rig.projector.shape, 128, np.uint8))
    levels = []
    while rig.clock.now() < shown + 0.1:
        rig.camera.trigger()
        frame = rig.camera.get_image(1)
        levels.append((frame.timestamp - 0.005 - shown, float(frame.data.mean())))
    assert rig.truth is not None
    # What can be measured of T is the difference to a black image, which leaks light.
    sums = 0.25 * rig.truth.matrix.sum(axis=1)
    dark = sums * HARDWARE.leak / (1 - HARDWARE.leak)
    expected, black = (
        64 + np.minimum(light, 1).mean() * (4095 - 64)
        for light in (sums * (128 / 255) ** 2 + dark, dark)
    )
    for start, level in levels:
        if start >= 3 / 60:
            assert level == pytest.approx(expected, abs=0.5)
        elif start < 3 / 60 - 0.005:
            assert level == pytest.approx(black, abs=0.5)


def test_frames_grow_stale_in_the_buffers_of_a_camera_that_runs_freely() -> None:
    rig = open_rig(f"{SIMULATED},fps=30,delay=0")
    rig.clock.sleep(1)
    shown = rig.projector.show(_white(rig))
    rig.clock.sleep(0.2)
    stale = [rig.camera.get_image(1) for _ in range(HARDWARE.buffers)]
    assert all(frame.timestamp < shown for frame in stale)
    rig.camera.flush()
    assert rig.camera.get_image(1).timestamp > shown


def test_a_camera_that_is_unplugged_comes_back() -> None:
    rig = faulty_rig(f"{SIMULATED},unplugged=5,unplugged_at=1")
    rig.camera.get_image(1)
    rig.clock.sleep(1)
    with pytest.raises(DeviceError, match="is gone"):
        rig.camera.get_image(1)
    rig.recover()
    assert 6 <= rig.clock.now() < 8
    assert rig.camera.get_image(1).timestamp > 6


def test_time_passes_as_it_does_unless_it_is_simulated() -> None:
    rig = open_rig(f"{REAL},fps=0")
    started = time.monotonic()
    rig.camera.exposure = 0.05
    rig.camera.trigger()
    rig.camera.get_image(1)
    assert 0.05 <= time.monotonic() - started < 60


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("l_objects", "write virtual:SCENE"),
        ("virtual:", "write virtual:SCENE"),
        ("virtual:metal,speed=3", "its options are size, delay"),
        ("virtual:metal,fps=often", "fps=1"),
        ("virtual:metal,size=1", "from 2 on"),
        ("virtual:metal,room=nan", "from 0 on"),
        ("virtual:metal,bits=12.5", "whole number"),
        ("virtual:metal,bits=11", "8, 10, 12, 16"),
        ("virtual:no such scene", "no scene called"),
    ],
)
def test_what_is_no_virtual_rig(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        open_rig(text)
    assert words in str(caught.value)
