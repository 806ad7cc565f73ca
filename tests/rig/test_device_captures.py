"""Whole captures through the back ends whose simulated cameras see nothing of a projector.

What the folder projector shows is photographed for them: as the picture that the virtual DSLR finds
before its lens, and in place of the ball that flies before the GenTL simulator. All else is theirs:
triggers, buffers, numbers, files, and a memory that is full after 26 pictures.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.files.images import read_image
from lightmatrix.rig.devices.base import Frame
from lightmatrix.rig.devices.dslr import DSLRCamera
from lightmatrix.rig.devices.folders import SHOWN
from lightmatrix.rig.devices.gentl import GenTLCamera
from lightmatrix.rig.rig import Rig
from lightmatrix.rig.rig_measurements import ExposureAdvice, Flicker, RigMeasurements, SettleTime

PROJECTOR, CAMERA, COUNT = (12, 16), (108, 144), 12
_BLACK, _NOISE = 8.0, 1.2
# Size of a JPEG file: virtual cameras look at it once.
_JPEG_BYTES = 40_000


@dataclass
class ShownScene:
    """A screen that is photographed straight on, each of its pixels in a block of the camera's.

    The screen is that of a folder projector. White is 0.8 of full scale at `exposure` seconds.
    """

    folder: Path
    exposure: float
    photographs: int = 0
    _surface: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self._surface = np.random.default_rng(5).uniform(0.4, 0.8, CAMERA)

    def light(self, image: NDArray[np.uint8], exposure: float) -> NDArray[np.float64]:
        """Levels (rows, cols) without noise."""
        down, across = (c // p for c, p in zip(CAMERA, PROJECTOR, strict=True))
        shown = np.kron(image / 255, np.ones((down, across)))
        return np.minimum(_BLACK + 247 * self._surface * shown * exposure / self.exposure, 255)

    def photograph(self, exposure: float) -> NDArray[np.uint8]:
        """What is shown now, with noise."""
        self.photographs += 1
        levels = self.light(read_image(self.folder / SHOWN), exposure)
        levels = levels + _NOISE * np.random.default_rng(self.photographs).standard_normal(CAMERA)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def write_jpeg(self, path: Path, exposure: float) -> None:
        """The same as a file, in place of one that is there."""
        content = io.BytesIO()
        grey = self.photograph(exposure)
        Image.fromarray(np.repeat(grey[..., None], 3, 2)).save(content, "JPEG", quality=98)
        data = content.getvalue()
        assert len(data) <= _JPEG_BYTES
        path.write_bytes(data.ljust(_JPEG_BYTES, b"\0"))

    def known(self, rig: Rig) -> RigMeasurements:
        """What measuring the rig at length would find."""
        return RigMeasurements(
            rig.projector.info(),
            rig.camera.info(),
            SettleTime(0.02, 0.0, 21, 0),
            Flicker(0.0, 0.0, 0.001, 0.0),
            ExposureAdvice((self.exposure,), 0.5, (0.0,), _NOISE / 255, _BLACK),
        )


def _captured(scene: ShownScene, camera: str, capsys: pytest.CaptureFixture[str]) -> lm.Capture:
    """The capture that one command makes, each frame that of its pattern."""
    projector = f"folder:{scene.folder},size={PROJECTOR[0]}x{PROJECTOR[1]}"
    with lm.open_rig(projector=projector, camera=camera) as rig:
        scene.known(rig).save("rig.json")
    words = f"capture --projector {projector} --camera {camera} -k {COUNT} -o capture "
    words += f"--exposure {scene.exposure}"
    assert main(words.split()) == 0, capsys.readouterr().err
    capture = lm.Capture.open("capture")
    provenance = capture.provenance
    assert (capture.count, provenance["left_out"]) == (COUNT, {})
    for k in range(COUNT):
        image = np.rint(255 * capture.patterns.images(k, k + 1)[0]).astype(np.uint8)
        apart = capture.frame(k) - scene.light(image, provenance["exposure_1_in_seconds"])
        assert np.sqrt((apart**2).mean()) < 3
    return capture


def test_a_capture_by_the_virtual_dslr(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gphoto2 = pytest.importorskip("gphoto2", reason="gphoto2 is missing: make test-install")
    virtual = Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"
    if not virtual.is_dir():
        pytest.skip("this gphoto2 has no virtual camera")
    monkeypatch.chdir(tmp_path)
    # One of its steps; it takes a picture in less time than longer ones would.
    scene = ShownScene(tmp_path / "show", 0.0025)
    seen = tmp_path / "seen"
    for folder in (scene.folder, seen):
        folder.mkdir()
    monkeypatch.setenv("IOLIBS", str(virtual))
    monkeypatch.setenv("VCAMERADIR", str(seen))
    trigger = DSLRCamera.trigger

    def look_and_trigger(self: DSLRCamera) -> None:
        scene.write_jpeg(seen / "seen.jpg", self.exposure)
        trigger(self)

    monkeypatch.setattr(DSLRCamera, "trigger", look_and_trigger)
    # There has to be something to see when it is switched on.
    (seen / "seen.jpg").write_bytes(bytes(40_000))
    capture = _captured(scene, "dslr", capsys)
    # Its three channels are alike, which is one.
    assert capture.camera_shape == CAMERA
    assert capture.provenance["rig"]["camera"]["name"] == "Nikon DSC D750"
    # Its memory was full after 26, and it was opened again.
    assert scene.photographs > 26


def test_a_capture_by_the_gentl_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    genicam = pytest.importorskip("genicam", reason="genicam is missing: make test-install")
    pytest.importorskip("harvesters", reason="harvesters is missing: make test-install")
    producer = Path(genicam.__file__).parent / "viky.cti"
    monkeypatch.chdir(tmp_path)
    scene = ShownScene(tmp_path / "show", 0.02)
    made: Any = GenTLCamera._frame

    def seen(self: GenTLCamera, buffer: Any) -> Frame:
        frame: Frame = made(self, buffer)
        assert frame.data.shape == CAMERA
        return replace(frame, data=scene.photograph(self.exposure))

    monkeypatch.setattr(GenTLCamera, "_frame", seen)
    size = f"Width={CAMERA[1]},Height={CAMERA[0]}"
    camera = f"gentl:VikyTL_DEV_red,producer={producer},exposure=0.02,{size}"
    capture = _captured(scene, camera, capsys)
    assert capture.camera_shape == CAMERA
    assert "Viky" in capture.provenance["rig"]["camera"]["name"]
