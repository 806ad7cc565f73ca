"""Aravis drives a camera over GigE Vision: a simulated one, through the real network stack.

A whole capture goes all the way: window, virtual screen, GigE Vision, capture, estimate.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.rig import rig_measurements
from lightmatrix.rig.devices.aravis import AravisCamera, find_aravis, open_aravis
from lightmatrix.rig.devices.base import Address
from lightmatrix.rig.devices.window import open_window
from lightmatrix.rig.rig import Rig
from lightmatrix.simulation.procedural import ProceduralScene

from .conftest import SCREEN
from .contract import CameraContract
from .gige import UNIT_EXPOSURE, GigECamera, ScreenRig, needs_aravis

pytestmark = needs_aravis
SHAPE = (24, 32)
SIDES, NOISE = (32, 32), 0.003


def _counting() -> object:
    levels = iter(range(1, 60000))
    return lambda exposure: np.full(SHAPE, next(levels), np.uint16)


@pytest.fixture
def served() -> Iterator[GigECamera]:
    camera = GigECamera(_counting(), SHAPE)  # type: ignore[arg-type]
    yield camera
    camera.close()
    assert not camera.errors


class TestGigE(CameraContract):
    @pytest.fixture
    def camera(self, served: GigECamera) -> Iterator[AravisCamera]:
        camera = open_aravis(Address.parse(served.address))
        yield camera
        camera.close()


class TestFreeRunningGigE(CameraContract):
    triggered = False

    @pytest.fixture
    def camera(self, served: GigECamera) -> Iterator[AravisCamera]:
        # So slow that its buffers last while a busy machine does something else.
        slow = served.address.replace("FrameRate=200", "FrameRate=25")
        camera = open_aravis(Address.parse(slow + ",trigger=free"))
        yield camera
        camera.close()


def test_a_camera_in_use(served: GigECamera) -> None:
    first = open_aravis(Address.parse(served.address))
    with pytest.raises(DeviceError, match="another program has the camera"):
        open_aravis(Address.parse(served.address))
    first.close()
    open_aravis(Address.parse(served.address)).close()


def test_an_unplugged_camera(served: GigECamera) -> None:
    camera = open_aravis(Address.parse(served.address))
    served.close()
    with pytest.raises(DeviceError, match="cannot be reached") as caught:
        camera.get_image(0.1)
    assert not isinstance(caught.value, FrameTimeoutError)
    # Aravis asks five times for half a second each, also to give the camera back. It can do that at
    # once if there is a camera again.
    again = GigECamera(_counting(), SHAPE)  # type: ignore[arg-type]
    camera.close()
    again.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (",PixelFormat=Mono12p", "Mono12p is not offered by it"),
        (",Gian=3", "no feature Gian"),
        (",GainRaw=loud", "GainRaw=loud was refused"),
        (",trigger=Line7", "no trigger 'Line7'"),
    ],
)
def test_settings_that_the_camera_refuses(served: GigECamera, options: str, words: str) -> None:
    address = served.address.replace(",PixelFormat=Mono16", "")
    with pytest.raises(DeviceError, match=words):
        open_aravis(Address.parse(address + options))


def test_packets_that_are_missing_are_named(
    served: GigECamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = open_aravis(Address.parse(served.address + ",trigger=free"))
    # Every frame counts as torn.
    statuses = SimpleNamespace(SUCCESS="none is")
    monkeypatch.setattr(camera, "_aravis", SimpleNamespace(BufferStatus=statuses))
    with pytest.raises(FrameTimeoutError, match="packets missing"):
        camera.get_image(0.3)
    camera.close()


def test_colour_comes_in_three_channels() -> None:
    image = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)

    def photograph(exposure: float) -> NDArray[np.uint16]:
        # Bytes of RGB8 in a row, two at a time.
        return image.reshape(-1).view(np.uint16)

    served = GigECamera(photograph, SHAPE, bytes_per_pixel=3)
    address = served.address.replace("Mono16", "RGB8")
    camera = open_aravis(Address.parse(address))
    camera.trigger()
    np.testing.assert_array_equal(camera.get_image(60).data, image)
    assert camera.info()["shape"] == (*SHAPE, 3)
    camera.close()
    served.close()


def test_no_such_camera() -> None:
    with pytest.raises(DeviceError, match="no such camera was found") as caught:
        open_aravis(Address("aravis", "Basler-0"))
    assert "lightmatrix rig list" in str(caught.value.hint)
    assert find_aravis() == []


def test_a_capture_over_gige_vision_is_as_good_as_a_simulated_one(
    screen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # A virtual screen shows pictures sooner than what a first measurement waits for.
    monkeypatch.setattr(rig_measurements, "FIRST_SETTLE", 0.05)
    monkeypatch.setattr(rig_measurements, "_WATCHED", 0.1)
    known = ProceduralScene(SIDES, SIDES, 0).truth()
    cell = min(SCREEN) // SIDES[0]
    left, top = ((length - SIDES[0] * cell) // 2 for length in SCREEN[::-1])
    scene = ScreenRig(known.matrix, SIDES, cell, left, top, NOISE)
    served = GigECamera(scene, SIDES)
    address = Address.parse(served.address)
    # The simulated camera misses one trigger in 20.
    monkeypatch.setattr(AravisCamera, "patience", 0.2)
    try:
        window = open_window(Address("window"))
        with Rig(window, open_aravis(address), lambda: open_aravis(address)) as rig:
            capture = lm.take_capture(
                "capture",
                rig,
                lm.make_patterns("mix", SIDES, 24),
                settings=lm.CaptureSettings(cell=cell),
            )
    finally:
        served.close()
    assert not served.errors
    provenance = capture.provenance
    assert (capture.count, provenance["left_out"]) == (24, {})
    scale = np.float32(provenance["exposure_1_in_seconds"] / UNIT_EXPOSURE)
    truth = known.scaled(scale)
    simulated = lm.simulate(truth, capture.patterns, exposure=1.0, bits=16, noise=NOISE)
    error = lm.evaluate(lm.estimate(capture, check=False), truth).relighting_error
    expected = lm.evaluate(lm.estimate(simulated, check=False), truth).relighting_error
    assert error < 1.05 * expected
