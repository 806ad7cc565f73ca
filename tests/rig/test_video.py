"""Video devices through PyAV: a virtual screen, read as a camera would be."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Address, Camera
from lightmatrix.rig.devices.registry import open_camera
from lightmatrix.rig.devices.window import open_window

from .contract import CameraContract

av = pytest.importorskip("av", reason="PyAV is missing: make test-install")
OPTIONS = "format=x11grab,size=240x320,fps=100,exposure=0.01"


class TestVideo(CameraContract):
    exposes = False
    triggered = False

    @pytest.fixture
    def camera(self, screen: str) -> Iterator[Camera]:
        camera = open_camera(f"video:{screen},{OPTIONS}")
        yield camera
        camera.close()


class TestGreen(TestVideo):
    @pytest.fixture
    def camera(self, screen: str) -> Iterator[Camera]:
        camera = open_camera(f"video:{screen},{OPTIONS},pixels=green")
        assert camera.info()["shape"] == (240, 320)
        yield camera
        camera.close()


def test_what_the_screen_shows_is_what_comes(screen: str) -> None:
    for name in ("glfw", "moderngl"):
        pytest.importorskip(name, reason=f"{name} is missing: make test-install")
    window = open_window(Address("window"))
    camera = open_camera(f"video:{screen},{OPTIONS},grab_x=16,grab_y=8")
    random = np.random.default_rng(0)
    try:
        for _ in range(5):
            image = random.integers(0, 256, (*window.shape, 3), np.uint8)
            shown = window.show(image)
            frame = camera.get_image(60)
            while frame.timestamp < shown + 0.05:
                frame = camera.get_image(60)
            np.testing.assert_array_equal(frame.data, image[8:248, 16:336])
    finally:
        camera.close()
        window.close()


def test_a_slow_reader_misses_old_frames_not_new_ones(screen: str) -> None:
    camera = open_camera(f"video:{screen},{OPTIONS}")
    camera.get_image(60)
    time.sleep(1)
    asked = time.monotonic()
    late = camera.get_image(60)
    camera.close()
    assert late.timestamp > asked - 0.4


def test_a_camera_that_ends(screen: str) -> None:
    camera = open_camera(f"video:{screen},{OPTIONS}")
    camera.get_image(60)

    def ends(*_: object) -> Any:
        raise OSError(errno.ENODEV, "No such device")

    camera._stamps.time = ends  # type: ignore[attr-defined]
    with pytest.raises(DeviceError, match=r"the camera is gone.*No such device"):
        _take(camera, 20)
    camera.close()


def _take(camera: Camera, count: int) -> None:
    for _ in range(count):
        camera.get_image(60)


@pytest.mark.parametrize(
    ("address", "kind", "words"),
    [
        ("video:/dev/video99,exposure=1", DeviceError, "cannot be opened.*video99"),
        ("video::99,format=x11grab,exposure=1", DeviceError, "cannot be opened"),
        ("video:/dev/video0,format=nonsense,exposure=1", DeviceError, "cannot be opened.*nonsense"),
        ("video:/dev/video0", InputError, "how long its frames are exposed"),
        ("video,exposure=1", InputError, "which video device"),
        ("video:/dev/video0,exposure=1,fsp=3", InputError, "no option 'fsp'"),
    ],
)
def test_what_cannot_be_opened(address: str, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        open_camera(address)
