"""Devices are opened by their names, and what is there is listed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from lightmatrix.cli import main
from lightmatrix.errors import DeviceError, InputError, MissingExtraError
from lightmatrix.rig.devices.base import Address
from lightmatrix.rig.devices.folders import WatchedFolder
from lightmatrix.rig.devices.registry import (
    CAMERAS,
    PROJECTORS,
    list_devices,
    open_camera,
    open_projector,
)
from lightmatrix.rig.rig import open_rig


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("window", ("window", "", {})),
        ("window:1", ("window", "1", {})),
        ("video::77.0,format=x11grab", ("video", ":77.0", {"format": "x11grab"})),
        ("watch:a, b,c/,exposure=0.1", ("watch", "a, b,c/", {"exposure": "0.1"})),
        ("aravis,Gain=0,trigger=Line1", ("aravis", "", {"Gain": "0", "trigger": "Line1"})),
    ],
)
def test_names_have_parts(text: str, parts: tuple[str, str, dict[str, str]]) -> None:
    address = Address.parse(text)
    assert (address.kind, address.argument, address.options) == parts
    assert str(address) == text


def test_names_that_are_none() -> None:
    with pytest.raises(InputError, match="beamer:1: no such projector") as caught:
        open_projector("beamer:1")
    assert all(kind in str(caught.value.hint) for kind in PROJECTORS)
    with pytest.raises(InputError, match="window:1: no such camera") as caught:
        open_camera("window:1")
    assert all(kind in str(caught.value.hint) for kind in CAMERAS)
    with pytest.raises(InputError, match="gives Gain twice"):
        open_camera("aravis:x,Gain=1,Gain=2")
    with pytest.raises(InputError, match="watch has no option 'expose'"):
        open_camera("watch:.,exposure=1,expose=1")


def test_a_rig_of_two_devices_is_opened_and_closed(tmp_path: Path) -> None:
    shows, takes = f"folder:{tmp_path},size=6x8", f"watch:{tmp_path},exposure=1"
    with open_rig(projector=shows, camera=takes) as rig:
        assert rig.projector.shape == (6, 8)
        assert rig.camera.exposure == 1
    for use in (rig.projector.black, rig.camera.flush):
        with pytest.raises(DeviceError, match="closed"):
            use()
    with pytest.raises(InputError, match="no such projector"):
        open_rig(projector="beamer", camera=takes)
    with pytest.raises(InputError, match="no rig to photograph with"):
        open_rig(projector=shows)


@pytest.mark.parametrize(
    ("address", "package", "hint"),
    [
        ("aravis", "gi", r"gir1\.2-aravis.*lightmatrix\[aravis\]"),
        ("gentl", "harvesters.core", r"lightmatrix\[gentl\]"),
        ("video:/dev/video0,exposure=1", "av", r"lightmatrix\[video\]"),
        ("dslr", "gphoto2", r"lightmatrix\[dslr\]"),
        ("window", "moderngl", r"lightmatrix\[window\]"),
    ],
)
def test_a_missing_package(
    address: str, package: str, hint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=hint):
        (open_projector if address == "window" else open_camera)(address)


def test_what_is_there_is_listed(
    two_screens: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("glfw", reason="glfw is missing: make test-install")
    # Its back end is not installed.
    monkeypatch.setitem(sys.modules, "gi", None)
    assert main(["rig", "list"]) == 0
    output = capsys.readouterr().out
    assert "window:1  DUMMY1, 600 x 800 at 85 Hz" in output
    assert "aravis cannot be used" in output.replace("Aravis", "aravis")
    assert "lightmatrix[aravis]" in output
    assert main(["rig", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["back_ends"]
    assert {(back["role"], back["kind"]) for back in listed} == {
        *(("projector", kind) for kind in PROJECTORS),
        *(("camera", kind) for kind in CAMERAS),
    }


def test_a_list_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    window = next(back for back in list_devices() if back.kind == "window")
    assert window.problem
    assert window.hint
    assert not window.found


def test_a_camera_that_gives_no_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    devices = "--projector folder:show,size=6x8 --camera watch:.,exposure=0.01"
    monkeypatch.setattr(WatchedFolder, "patience", 0.01)
    words = f"capture {devices} -o capture"
    assert main(words.split()) == 2
    errors = capsys.readouterr().err
    assert "the camera gives no frames: watch:.,exposure=0.01: no frame within" in errors
    # Its back end's own advice.
    assert "does the other program write PNG" in errors
    assert not list(tmp_path.glob("capture*"))
