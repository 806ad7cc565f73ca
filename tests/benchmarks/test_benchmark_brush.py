"""The brush-stroke benchmark: it compares the light before it times it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks import brush


def test_strokes_are_compared_and_timed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "s.zarr")
    lm.save(path, lm.truth("metal").transport())
    lm.index_columns(path)
    brush.main([path, "--side", "9", "--strokes", "12"])
    found = json.loads(capsys.readouterr().out)
    assert found["stroke_anywhere"]["longest"] >= found["stroke_anywhere"]["median"] > 0
    monkeypatch.setattr(lm.ColumnIndex, "light", lambda *_: np.zeros((64, 64), np.float32))
    with pytest.raises(SystemExit, match="differ in the light"):
        brush.main([path])
