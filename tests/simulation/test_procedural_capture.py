"""Procedural captures: the same frames as `simulate`, and the same truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture import packing
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.simulation import procedural as procedural_capture
from lightmatrix.simulation.procedural import scene_of

SCENE = lm.ProceduralScene((13, 11), (8, 9), seed=2)
PATTERNS = lm.BernoulliPatterns((8, 9), 40)


@pytest.mark.parametrize("name", ["made.zarr", "made"])
@pytest.mark.parametrize("settings", [{}, {"exposure": "1:0.5,0.2:0.5", "bits": 12, "seed": 5}])
def test_blocks_are_the_frames_of_the_whole(
    tmp_path: Path, name: str, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(procedural_capture, "_ROWS", 10)
    monkeypatch.setattr(procedural_capture, "_SAMPLES", 1)
    monkeypatch.setattr(procedural_capture, "_PATTERN_BYTES", 1)
    monkeypatch.setattr(packing, "_CHUNK_BYTES", 1000)
    steps: list[tuple[int, int]] = []
    made = lm.simulate_procedural(
        tmp_path / name, SCENE, PATTERNS, **settings, progress=lambda *step: steps.append(step)
    )
    whole = lm.simulate(SCENE.truth(), PATTERNS, **settings)
    assert made.digest == whole.digest
    assert steps[-1] == (143, 143)
    assert len(steps) > 5
    assert scene_of(made.provenance) == SCENE
    known = lm.truth(tmp_path / name)
    assert (known.matrix != SCENE.truth().matrix).nnz == 0


def test_the_command_and_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = "simulate procedural --camera 12x10 --size 8x8 -k 24 -o {}/c.zarr --json"
    assert main(line.format(tmp_path).split()) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 24
    scene = lm.ProceduralScene((12, 10), (8, 8))
    made = lm.simulate_procedural(tmp_path / "d", scene, lm.BernoulliPatterns((8, 8), 24))
    assert made.digest == lm.Capture.open(tmp_path / "c.zarr").digest
    assert main(f"estimate {tmp_path}/c.zarr -o {tmp_path}/s.zarr --solver romp".split()) == 0
    outputs = []
    for truth in ("c.zarr", "d"):
        capsys.readouterr()
        assert main(f"evaluate {tmp_path}/s.zarr --truth {tmp_path}/{truth} --json".split()) == 0
        outputs.append(json.loads(capsys.readouterr().out))
    assert outputs[0] == outputs[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("procedural --size 8x8 -k 8 --leak 0.1", "--leak for procedural"),
        ("procedural --patterns {}/p -k 8", "-k for patterns of a folder"),
        ("metal --patterns {}/p --camera 8x8", "--camera for metal"),
        ("metal", "--patterns is missing"),
        ("procedural --size 8", "exists already"),
    ],
)
def test_conflicting_options_are_refused(
    tmp_path: Path, words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lm.write_patterns(tmp_path / "p", PATTERNS)
    if message == "exists already":
        lm.simulate_procedural(tmp_path / "c.zarr", SCENE, PATTERNS)
    line = f"simulate {words} -o {{}}/c.zarr".replace("{}", str(tmp_path))
    assert main(line.split()) == 2
    assert message in capsys.readouterr().err


def test_a_truth_that_does_not_fit_is_refused_before_it_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lightmatrix.resources.memory.available_bytes", lambda: 1000)
    with pytest.raises(InputError, match="announces"):
        lm.simulate_procedural(tmp_path / "c.zarr", SCENE, PATTERNS, truth=True)
    assert not list(tmp_path.iterdir())
    lm.simulate_procedural(tmp_path / "c.zarr", SCENE, PATTERNS)
    with pytest.raises(InputError, match="announces"):
        lm.truth(tmp_path / "c.zarr")


def test_other_captures_have_no_truth_to_make(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (40, 5, 6)).astype(np.uint8)
    lm.pack(lm.Capture.from_arrays(PATTERNS, frames, lm.Sensor()), tmp_path / "c.zarr")
    with pytest.raises(InputError, match=r"holds no truth\.npz"):
        lm.truth(tmp_path / "c.zarr")
    with pytest.raises(InputError, match="cannot be read"):
        scene_of({"procedural": {"camera_shape": [3]}})
