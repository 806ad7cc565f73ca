"""Digital cameras through gphoto2: the virtual one that its wheel brings."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import DeviceError
from lightmatrix.rig.devices.base import Address, Camera
from lightmatrix.rig.devices.dslr import _seconds, find_dslr, open_dslr
from lightmatrix.rig.devices.registry import open_camera

from .contract import CameraContract

gphoto2 = pytest.importorskip("gphoto2", reason="gphoto2 is missing: make test-install")
VIRTUAL = Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"
pytestmark = pytest.mark.skipif(not VIRTUAL.is_dir(), reason="this gphoto2 has no virtual camera")
SHAPE = (48, 64, 3)
Picture = NDArray[np.uint8]


@pytest.fixture
def picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Picture:
    """What the virtual camera sees."""
    ramp = np.add.outer(2 * np.arange(SHAPE[0]), np.arange(SHAPE[1])).astype(np.uint8)
    Image.fromarray(np.repeat(ramp[..., None], 3, 2)).save(tmp_path / "seen.jpg", quality=95)
    monkeypatch.setenv("IOLIBS", str(VIRTUAL))
    monkeypatch.setenv("VCAMERADIR", str(tmp_path))
    return np.asarray(Image.open(tmp_path / "seen.jpg"))


class TestDSLR(CameraContract):
    @pytest.fixture
    def camera(self, picture: Picture) -> Iterator[Camera]:
        camera = open_camera("dslr")
        yield camera
        camera.close()


def test_pictures_are_what_it_saw(picture: Picture) -> None:
    camera = open_camera("dslr:Nikon DSC D750")
    camera.exposure = 0.02
    camera.trigger()
    np.testing.assert_array_equal(camera.get_image(60).data, picture)
    # It has steps.
    camera.exposure = 0.0021
    assert camera.exposure == pytest.approx(0.0025)
    camera.close()


@pytest.mark.parametrize("exposure", [0.0025, 0.5])
def test_no_exposure_began_before_it_was_asked_for(picture: Picture, exposure: float) -> None:
    # The virtual camera hands pictures over at once, whatever its shutter is set to: it was taken
    # for one that had been under way, and another one was waited for that never came.
    camera = open_camera("dslr")
    camera.exposure = exposure
    asked = time.monotonic()
    camera.trigger()
    assert camera.get_image(60).timestamp - camera.exposure >= asked
    camera.close()


def test_cameras_are_found(picture: Picture) -> None:
    (device,) = find_dslr()
    assert (device.address, device.description) == ("dslr:usb:001,001", "Nikon DSC D750")
    open_camera(device.address).close()


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1/125", 1 / 125), ("0.0100s", 0.01), ("30", 30), ("1.3", 1.3), ("bulb", None), ("0", None)],
)
def test_shutter_speeds_as_cameras_write_them(text: str, seconds: float | None) -> None:
    assert _seconds(text) == seconds


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("dslr:Canon", r"no such camera was found; there are: Nikon DSC D750 \(usb:001,001\)"),
        ("dslr,shuterspeed=1", "no setting 'shuterspeed'"),
        ("dslr,imagesize=1x1", "imagesize cannot be '1x1'"),
    ],
)
def test_what_the_camera_refuses(picture: Picture, address: str, words: str) -> None:
    with pytest.raises(DeviceError, match=words):
        open_camera(address)


def test_a_camera_in_use(picture: Picture, monkeypatch: pytest.MonkeyPatch) -> None:
    real: Any = gphoto2.Camera

    class Claimed(real):  # type: ignore[misc]
        def init(self, *_: object) -> None:
            raise gphoto2.GPhoto2Error(gphoto2.GP_ERROR_IO_USB_CLAIM)

    monkeypatch.setattr(gphoto2, "Camera", Claimed)
    with pytest.raises(DeviceError, match="another program has the camera"):
        open_camera("dslr")


def test_files_that_are_no_photographs(picture: Picture) -> None:
    camera = open_dslr(Address("dslr"))
    with pytest.raises(DeviceError, match=r"\.mov files, which are not read"):
        camera._frame("DSC_1.MOV", b"", 0.0)
    with pytest.raises(DeviceError, match=r"DSC_1\.JPG came damaged"):
        camera._frame("DSC_1.JPG", b"half of it", 0.0)
    camera.close()
