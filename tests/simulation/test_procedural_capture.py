"""`lightmatrix simulate procedural`: a capture of any size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.procedural_captures import photograph
from lightmatrix.cli import main
from lightmatrix.errors import InputError

SCENE = lm.ProceduralScene((8, 8), (8, 8))
PATTERNS = lm.BernoulliPatterns((8, 8), 24)


def test_the_command_and_the_strips_of_the_benchmarks_give_the_same_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lm.write_patterns(tmp_path / "p", PATTERNS)
    line = "simulate procedural --patterns {0}/p -o {0}/c.zarr --json"
    assert main(line.format(tmp_path).split()) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 24
    photograph(tmp_path / "d.zarr", SCENE, PATTERNS)
    digest = lm.Capture.open(tmp_path / "c.zarr").digest
    assert lm.Capture.open(tmp_path / "d.zarr").digest == digest
    assert (lm.truth(tmp_path / "c.zarr").matrix != SCENE.truth().matrix).nnz == 0


def test_a_truth_that_does_not_fit_is_refused_before_it_is_computed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("lightmatrix.resources.memory.available_bytes", lambda: 1000)
    with pytest.raises(InputError, match="T of this scene takes"):
        SCENE.truth()


def test_other_captures_have_no_truth(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (24, 5, 6)).astype(np.uint8)
    lm.pack(lm.Capture.from_arrays(PATTERNS, frames, lm.Sensor()), tmp_path / "c.zarr")
    with pytest.raises(InputError, match=r"holds no truth\.npz"):
        lm.truth(tmp_path / "c.zarr")
