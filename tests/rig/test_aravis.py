"""Aravis drives a camera over GigE Vision: a simulated one, through the real network stack."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array, random_array

from lightmatrix.errors import DeviceError, FrameTimeoutError, MissingExtraError
from lightmatrix.rig.devices.aravis import AravisCamera, find_aravis, open_aravis
from lightmatrix.rig.devices.base import Address, Frame
from lightmatrix.rig.devices.window import open_window

from .conftest import SCREEN
from .contract import CameraContract
from .gige import UNIT_EXPOSURE, GigECamera, ScreenRig, needs_aravis

pytestmark = needs_aravis
SHAPE = (24, 32)
# All 64 come back in `test_gige_capture.py`.
_COUNT = 24


def _counting() -> object:
    levels = iter(range(1, 60000))
    return lambda exposure: np.full(SHAPE, next(levels), np.uint16)


def _frame(camera: AravisCamera) -> Frame:
    """A frame; a second try if the loopback network of a busy machine lost it, as networks do."""
    try:
        camera.trigger()
        return camera.get_image(60)
    except FrameTimeoutError:
        camera.trigger()
        return camera.get_image(60)


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


def test_patterns_on_a_screen_come_back_as_the_camera_saw_them(screen: str) -> None:
    """The whole optical path but for the optics: window, T, noise-free camera, network."""
    for name in ("glfw", "moderngl", "mss"):
        pytest.importorskip(name, reason=f"{name} is missing: make test-install")
    projector = (16, 16)
    matrix = csr_array(
        random_array((SHAPE[0] * SHAPE[1], 256), density=0.006, rng=np.random.default_rng(2))
    )
    rig = ScreenRig(matrix, SHAPE, projector, noise=0.0, size=SCREEN)
    served = GigECamera(rig, SHAPE)
    window = open_window(Address("window"))
    camera = open_aravis(Address.parse(served.address))
    camera.exposure = 2 * UNIT_EXPOSURE
    random = np.random.default_rng(3)
    clipped = 0
    ids = []
    try:
        for _ in range(_COUNT):
            pattern = random.integers(0, 2, projector, np.uint8) * np.uint8(255)
            blocks = np.ones((SCREEN[0] // 16, SCREEN[1] // 16), np.uint8)
            shown = window.show(np.kron(pattern, blocks))
            frame = _frame(camera)
            light = 2 * (matrix @ (pattern.ravel() / 255)) * 65535
            np.testing.assert_allclose(frame.data.ravel(), np.minimum(light, 65535), atol=1)
            assert frame.timestamp > shown
            clipped += int((frame.data == frame.clip_level).sum())
            ids.append(frame.id)
    finally:
        camera.close()
        window.close()
        served.close()
    assert not served.errors
    assert ids == sorted(set(ids))
    assert ids[-1] - ids[0] < _COUNT + 2
    # Some clip, as they are meant to.
    assert 0.02 < clipped / (_COUNT * SHAPE[0] * SHAPE[1]) < 0.5


def test_ids_go_on_where_the_camera_begins_again(served: GigECamera) -> None:
    # Its 16-bit numbers begin at 65,400 and go from 65,535 to 1.
    camera = open_aravis(Address.parse(served.address + ",trigger=free"))
    ids = [camera.get_image(60).id for _ in range(200)]
    camera.close()
    assert ids[0] < 65535 < ids[-1]
    # One may get lost on a busy machine.
    assert ids == sorted(ids)
    assert ids[-1] - ids[0] < 210


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
    camera.close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (",PixelFormat=Mono12p", "Mono12p cannot be used, it does not offer that"),
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


def test_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    with pytest.raises(MissingExtraError, match=r"gir1\.2-aravis.*\.\[aravis\]"):
        open_aravis(Address("aravis"))
