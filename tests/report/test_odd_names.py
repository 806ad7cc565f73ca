"""A report about a store whose name is no text."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

import lightmatrix as lm
from lightmatrix.cli import main


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
def test_a_name_that_is_no_text_does_not_stop_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lm.simulate("metal", lm.BernoulliPatterns((64, 64), 2)).save("capture")
    name = os.fsdecode(b"b\xff.zarr")
    line = ["estimate", "capture", "--no-coherent", "--crop", "0,0:8x8", "--report", "rep", "-o"]
    assert main([*line, name]) == 0
    assert Path(name).is_dir()
    assert "<html" in Path("rep/report.html").read_text(encoding="utf-8")
