"""Projectors and cameras that are folders, for whatever shows and takes pictures there."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError, OutputError
from lightmatrix.files.images import read_image, write_image
from lightmatrix.rig.devices.base import Camera, Projector
from lightmatrix.rig.devices.folders import SHOWN, WatchedFolder
from lightmatrix.rig.devices.registry import open_camera, open_projector

from .contract import CameraContract, ProjectorContract

SHAPE = (48, 64)


class TestFolderProjector(ProjectorContract):
    @pytest.fixture
    def projector(self, tmp_path: Path) -> Iterator[Projector]:
        self._place = tmp_path / "to show"
        projector = open_projector(f"folder:{self._place},size=48x64")
        yield projector
        projector.close()

    def shown(self, projector: Projector) -> NDArray[np.uint8]:
        image = read_image(self._place / SHOWN)
        return image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)


def test_a_viewer_never_sees_half_an_image(tmp_path: Path) -> None:
    projector = open_projector(f"folder:{tmp_path},size=48x64")
    stop = threading.Event()
    seen: list[int] = []
    wrong: list[BaseException] = []

    def view() -> None:
        while not stop.is_set():
            try:
                image = read_image(tmp_path / SHOWN)
                assert image.min() == image.max()
                seen.append(int(image[0, 0]))
            except BaseException as error:
                wrong.append(error)

    viewer = threading.Thread(target=view)
    viewer.start()
    for value in range(60):
        projector.show(np.full(SHAPE, value, np.uint8))
    stop.set()
    viewer.join()
    assert not wrong
    assert len(set(seen)) > 5


@pytest.mark.parametrize(
    "address", ["folder", "folder:there", "folder:there,size=64", "folder:a,size=0x9"]
)
def test_a_folder_without_a_size(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="a folder and its size are needed"):
        open_projector(address)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        open_projector(f"folder:{tmp_path / 'file'},size=48x64")


class TestWatchedFolder(CameraContract):
    exposes = False
    # Frames come when the other program takes them, as if it were asked.
    triggered = True

    @pytest.fixture
    def camera(self, tmp_path: Path) -> Iterator[WatchedFolder]:
        # What is there already is none of its frames.
        write_image(tmp_path / "frame 7.png", np.zeros((3, 3), np.uint8))
        self._place, self._next = tmp_path, 8
        camera = open_camera(f"watch:{tmp_path},exposure=0.02")
        assert isinstance(camera, WatchedFolder)
        assert camera.exposure == 0.02
        yield camera
        camera.close()

    def take(self, camera: Camera) -> None:
        image = np.full(SHAPE, self._next, np.uint16)
        write_image(self._place / f"frame {self._next}.png", image)
        self._next += 1


def test_a_file_is_read_when_it_is_whole(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (200, 300), np.uint8)
    write_image(tmp_path / "source.png", image)
    content = (tmp_path / "source.png").read_bytes()
    camera = open_camera(f"watch:{tmp_path},exposure=1")

    with (tmp_path / "slow.png").open("wb") as stream:
        stream.write(content[: len(content) // 2])
        stream.flush()
        with pytest.raises(FrameTimeoutError, match=r"slow\.png.*damaged or truncated"):
            camera.get_image(0.5)
        stream.write(content[len(content) // 2 :])
    np.testing.assert_array_equal(camera.get_image(60).data, image)


def test_frames_come_in_the_order_in_which_they_were_taken(tmp_path: Path) -> None:
    camera = open_camera(f"watch:{tmp_path},exposure=1,clip=200")
    now, clock = time.time(), time.monotonic()
    # 3 was lost, and 4 copied last although taken first.
    for number, age in ((1, 5.0), (2, 4.0), (5, 2.0), (4, 3.0)):
        path = tmp_path / f"IMG_{number:04}.png"
        write_image(path, np.full(SHAPE, number, np.uint8))
        os.utime(path, (now - age, now - age))
    frames = [camera.get_image(60) for _ in range(4)]
    assert [int(frame.data[0, 0]) for frame in frames] == [1, 2, 4, 5]
    assert frames[0].timestamp == pytest.approx(clock - 5, abs=1)
    assert frames[0].clip_level == 200


def test_a_file_that_is_written_again_is_a_new_frame(tmp_path: Path) -> None:
    for value in (1, 2, 3):
        if value == 2:
            camera = open_camera(f"watch:{tmp_path},exposure=1")
        write_image(tmp_path / "tethered.png", np.full(SHAPE, value, np.uint8), overwrite=True)
        if value > 1:
            assert int(camera.get_image(60).data[0, 0]) == value
    with pytest.raises(FrameTimeoutError, match=r"no frame within"):
        camera.get_image(0.15)


def test_one_photograph_in_two_formats_is_one_frame(tmp_path: Path) -> None:
    # Photographs that are there already are passed over in either format.
    for ending in ("jpg", "png"):
        Image.fromarray(np.zeros(SHAPE, np.uint8)).save(tmp_path / f"old.{ending}")
    for first in ("jpg", "png"):
        camera = open_camera(f"watch:{tmp_path},exposure=1")
        Image.fromarray(np.full(SHAPE, 7, np.uint8)).save(tmp_path / f"{first}.{first}")
        camera.get_image(60)
        with pytest.raises(FrameTimeoutError):
            camera.get_image(0.15)
    camera = open_camera(f"watch:{tmp_path},exposure=1")
    for number, endings in enumerate((("jpg", "png"), ("jpg", "png"), ("png", "jpg")), 1):
        for ending in endings:
            image = np.full(SHAPE, number, np.uint8)
            Image.fromarray(image).save(tmp_path / f"IMG_{number}.{ending}")
        assert int(camera.get_image(60).data[0, 0]) == number
    with pytest.raises(FrameTimeoutError) as caught:
        camera.get_image(0.15)
    assert ".png" in str(caught.value.hint)


@pytest.mark.parametrize("first", ["jpg", "png"])
def test_pairs_that_are_there_before_are_passed_over(tmp_path: Path, first: str) -> None:
    def save(number: int, *endings: str) -> None:
        for ending in endings:
            Image.new("L", SHAPE, number).save(tmp_path / f"IMG_{number}.{ending}")

    save(1, "jpg", "png")
    camera = open_camera(f"watch:{tmp_path},exposure=1")
    save(2, "jpg", "png")
    camera.flush()
    save(3, first)
    assert camera.get_image(60).data[0, 0] == 3
    with pytest.raises(FrameTimeoutError):
        camera.get_image(0.15)


def test_what_no_camera_takes(tmp_path: Path) -> None:
    camera = open_camera(f"watch:{tmp_path},exposure=1")
    write_image(tmp_path / "a.npy", np.zeros(SHAPE, np.float32))
    with pytest.raises(DeviceError, match="float32, which no sensor delivers"):
        camera.get_image(2)
    write_image(tmp_path / "b.png", np.zeros(SHAPE, np.uint8))
    camera.get_image(2)
    write_image(tmp_path / "c.png", np.zeros(SHAPE[::-1], np.uint8))
    with pytest.raises(DeviceError, match="is 64 x 48, the frames before were 48 x 64"):
        camera.get_image(2)
    (tmp_path / "notes.txt").write_text("no frame")
    (tmp_path / ".hidden.png").write_text("no frame")
    with pytest.raises(FrameTimeoutError, match="no frame within") as caught:
        camera.get_image(0.1)
    assert ".png" in str(caught.value.hint)


def test_what_cannot_be_watched(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_camera(f"watch:{tmp_path / 'nowhere'},exposure=1")
    with pytest.raises(InputError, match="how long") as caught:
        open_camera(f"watch:{tmp_path}")
    assert "exposure=SECONDS" in str(caught.value.hint)
    with pytest.raises(InputError, match="exposure is 'long'"):
        open_camera(f"watch:{tmp_path},exposure=long")
    place = tmp_path / "gone"
    place.mkdir()
    camera = open_camera(f"watch:{place},exposure=1")
    place.rmdir()
    with pytest.raises(DeviceError, match="cannot be read"):
        camera.get_image(0.1)
