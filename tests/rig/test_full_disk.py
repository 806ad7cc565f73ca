"""A full disk is reported, and no frame is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

import lightmatrix as lm
from lightmatrix.cli import main

from .small_disk import small_disk

RIG = "virtual:procedural,size=16,real=0,fps=0"
COUNT = 24


def _words(place: Path) -> list[str]:
    settings = "--settle 0.05 --exposure 0.02 --seed 3"
    files = f"-o {place / 'capture'} --rig-file {place / 'rig.json'}"
    return f"capture --rig {RIG} -k {COUNT} {settings} {files}".split()


def test_a_capture_goes_on_when_a_full_disk_has_room_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path) as disk:
        if disk is None:
            pytest.skip("no disk can be mounted: not root, or not allowed")
        # None at all, and enough for some frames, twice.
        kept = []
        for room in (0, 40 << 10, 24 << 10):
            disk.leave(room)
            assert main(_words(tmp_path)) == 2
            errors = capsys.readouterr().err
            assert "No space left on device" in errors
            assert "Traceback" not in errors
            assert not (tmp_path / "capture").exists()
            kept.append(len(list(tmp_path.glob("capture.partial/image_*.tif"))))
        assert 0 == kept[0] < kept[1] <= kept[2]
        disk.free()
        assert main(_words(tmp_path)) == 0
        assert lm.Capture.open(tmp_path / "capture").count == COUNT
        assert not list(tmp_path.glob("*partial*"))
