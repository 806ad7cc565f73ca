"""Whole captures through the back ends whose simulated cameras see nothing of a projector.

What the folder projector shows is photographed for them: as the picture that the virtual DSLR finds
before its lens, and in place of the ball that flies before the GenTL simulator. All else is theirs:
triggers, buffers, numbers, files, and a memory that is full after 26 pictures.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.rig.devices.base import Frame
from lightmatrix.rig.devices.dslr import DSLRCamera
from lightmatrix.rig.devices.gentl import GenTLCamera

from .scenes import ShownScene

PROJECTOR, CAMERA, COUNT = (12, 16), (108, 144), 12


def _scene(folder: Path, exposure: float) -> ShownScene:
    return ShownScene(folder / "show", PROJECTOR, CAMERA, exposure)


def _captured(scene: ShownScene, camera: str, capsys: pytest.CaptureFixture[str]) -> lm.Capture:
    """The capture that one command makes, each frame that of its pattern."""
    projector = f"folder:{scene.folder},size={PROJECTOR[1]}x{PROJECTOR[0]}"
    with lm.open_rig(projector=projector, camera=camera) as rig:
        scene.known(rig).save("rig.json")
    words = f"capture --projector {projector} --camera {camera} -k {COUNT} -o capture"
    assert main(words.split()) == 0, capsys.readouterr().err
    capture = lm.Capture.open("capture")
    provenance = capture.provenance
    assert (capture.count, provenance["left_out"]) == (COUNT, {})
    assert set(provenance["checks"]) <= {"matched", "confirmed"}
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
    scene = _scene(tmp_path, 0.0025)
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
    scene = _scene(tmp_path, 0.02)
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
