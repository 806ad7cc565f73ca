"""GenTL producers through harvesters: the simulated one that the genicam wheel brings."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Camera, Frame
from lightmatrix.rig.devices.gentl import GenTLCamera, find_gentl
from lightmatrix.rig.devices.registry import open_camera

from .contract import CameraContract

genicam = pytest.importorskip("genicam", reason="genicam is missing: make test-install")
pytest.importorskip("harvesters", reason="harvesters is missing: make test-install")
PRODUCER = Path(genicam.__file__).parent / "viky.cti"
RED = f"gentl:VikyTL_DEV_red,producer={PRODUCER},exposure=0.01"


class TestGenTL(CameraContract):
    # It has neither an exposure nor a trigger.
    exposes = False
    triggered = False

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        camera = open_camera(RED)
        yield camera
        camera.close()


def test_frames_are_pictures() -> None:
    camera = open_camera(f"{RED},Width=320,Height=240")
    frames = [camera.get_image(60).data for _ in range(8)]
    camera.close()
    assert {frame.shape for frame in frames} == {(240, 320)}
    # A ball that flies.
    assert int(frames[0].max()) - int(frames[0].min()) > 50
    assert (frames[0] != frames[-1]).any()


def test_flush_throws_away_what_waits_in_the_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its frames carry no time, so that stale ones would pass for new."""
    numbers, frame = list[int](), GenTLCamera._frame

    def noted(self: GenTLCamera, buffer: Any) -> Frame:
        numbers.append(buffer.module.frame_id)
        return frame(self, buffer)

    monkeypatch.setattr(GenTLCamera, "_frame", noted)
    camera = open_camera(RED)
    camera.get_image(60)
    time.sleep(1)
    camera.flush()
    camera.get_image(60)
    camera.close()
    assert numbers[1] > numbers[0] + 2


def test_cameras_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(PRODUCER.parent))
    devices = find_gentl()
    assert [device.address for device in devices] == [
        f"gentl:VikyTL_DEV_{colour}" for colour in ("red", "green", "blue")
    ]
    # By its serial number, too.
    camera = open_camera("gentl:2,exposure=1")
    assert "Viky" in camera.info()["name"]
    camera.close()


def test_a_camera_in_use() -> None:
    first = open_camera(RED)
    with pytest.raises(DeviceError, match=r"another program has it"):
        open_camera(RED)
    first.get_image(60)
    first.close()
    open_camera(RED).close()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (",PixelFormat=RGBa8", "RGBa8 is not unpacked by us"),
        (",PixelFormat=Mono16", "Mono16 is not offered by it"),
        (",Gian=3", "no feature Gian"),
        (",Width=wide", "Width=wide was refused"),
        (",trigger=software", "no trigger 'software'"),
    ],
)
def test_settings_that_the_camera_refuses(options: str, words: str) -> None:
    with pytest.raises(DeviceError, match=words):
        open_camera(RED + options)


def test_what_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match="no such camera was found; there are: VikyTL_DEV_red,"):
        open_camera(RED.replace("_red", "_pink"))
    with pytest.raises(InputError, match="how long its frames are exposed"):
        open_camera(RED.replace(",exposure=0.01", ""))
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(DeviceError, match="no GenTL producer in sight"):
        open_camera("gentl")
    (tmp_path / "broken.cti").write_text("no producer")
    with pytest.raises(DeviceError, match=r"cannot be loaded"):
        open_camera(f"gentl,producer={tmp_path / 'broken.cti'},exposure=1")
