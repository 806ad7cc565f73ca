"""Displays without hardware: X servers that are started for these tests."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

SCREEN = (768, 1024)
SECOND = (600, 800)
_DUMMY = """
Section "Device"
  Identifier "device"
  Driver "dummy"
  VideoRam 32000
EndSection
Section "Monitor"
  Identifier "monitor"
  HorizSync 5.0-1000.0
  VertRefresh 5.0-200.0
EndSection
Section "Screen"
  Identifier "screen"
  Device "device"
  Monitor "monitor"
  DefaultDepth 24
  SubSection "Display"
    Modes "1024x768" "800x600"
    Virtual 2048 768
  EndSubSection
EndSection
"""


@pytest.fixture(scope="session")
def _xvfb() -> Iterator[str]:
    command = _program("Xvfb")
    with _server([command, "-screen", "0", f"{SCREEN[1]}x{SCREEN[0]}x24"]) as display:
        yield display


@pytest.fixture
def screen(_xvfb: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """A virtual screen of `SCREEN` pixels, which DISPLAY names."""
    monkeypatch.setenv("DISPLAY", _xvfb)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return _xvfb


@pytest.fixture(scope="session")
def _xorg(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    xorg, xrandr = _program("Xorg"), _program("xrandr")
    if not Path("/usr/lib/xorg/modules/drivers/dummy_drv.so").exists():
        pytest.skip("Xorg's dummy driver is missing: make system-deps")
    folder = tmp_path_factory.mktemp("xorg")
    (folder / "xorg.conf").write_text(_DUMMY)
    options = ["-config", str(folder / "xorg.conf"), "-logfile", str(folder / "xorg.log")]
    with _server([xorg, *options]) as display:
        for words in (
            ("--addmode", "DUMMY1", f"{SECOND[1]}x{SECOND[0]}"),
            ("--output", "DUMMY1", "--mode", f"{SECOND[1]}x{SECOND[0]}", "--right-of", "DUMMY0"),
            # To be connected is seen when it is looked at.
            ("--query",),
        ):
            ask = [xrandr, "--display", display, *words]
            subprocess.run(ask, check=True, stdout=subprocess.DEVNULL)
        yield display


@pytest.fixture
def two_screens(_xorg: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """A monitor of `SCREEN` pixels and one of `SECOND` to the right of it."""
    monkeypatch.setenv("DISPLAY", _xorg)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return _xorg


def _program(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is missing: make system-deps")
    return path


@contextmanager
def _server(command: list[str]) -> Iterator[str]:
    """An X server on a display of its own choice, which it says when it is ready."""
    reading, writing = os.pipe()
    process = subprocess.Popen(
        # Without -noreset it begins anew when its last window closes, and refuses the next one.
        [*command, "-noreset", "-displayfd", str(writing), "-nolisten", "tcp"],
        pass_fds=[writing],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    try:
        with os.fdopen(reading) as pipe:
            number = pipe.readline().strip()
        assert number, f"{command[0]} did not start"
        yield f":{number}"
    finally:
        process.terminate()
        process.wait(timeout=120)
