"""The experiment on few patterns: its claims at small size, and that it continues after a stop."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.cli import main
from lightmatrix.experiments import few_patterns
from lightmatrix.experiments.few_patterns import Case, means, measure
from lightmatrix.experiments.harness import Measured
from lightmatrix.experiments.measured_scene import THREE_EXPOSURES, MeasuredScene
from lightmatrix.experiments.run import EXPERIMENTS
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation import library

pytestmark = pytest.mark.usefixtures("small_scenes")
SMALL = Case("gripper", "coherent", 64, 0, size=(32, 32))


def test_coherent_is_nearly_as_good_as_knowing_where_the_light_is() -> None:
    coherent, row_by_row, known = (
        measure(replace(SMALL, method=method)).rows[0]["relative_error"]
        for method in ("coherent", "row by row", "known support")
    )
    assert coherent < 0.2 * row_by_row
    assert coherent < 1.25 * known


def test_mixed_exposures_recover_clipped_responses() -> None:
    one = measure(SMALL).rows[0]["all_rows"]
    three = measure(replace(SMALL, exposures=THREE_EXPOSURES)).rows[0]["all_rows"]
    assert three < 0.3 * one


def test_a_camera_that_does_not_clip_has_the_same_noise() -> None:
    scene = MeasuredScene(library.truth("gripper"))
    patterns = BernoulliPatterns((64, 64), 8)
    clipping = scene.capture(patterns, 0)
    clean = scene.capture(patterns, 0, clipping=False)
    assert clean.reference_level == pytest.approx(clipping.reference_level)
    a, b = clipping.samples(), clean.samples()
    assert a.clipped.any()
    assert not b.clipped.any()
    unit = clipping.reference_level
    assert np.abs(a.values - b.values)[~a.clipped].max() < 2 / 255 * unit
    assert (b.values[a.clipped] > 0.98 * unit).all()


def test_means_over_seeds() -> None:
    row = {**SMALL.__dict__, "relative_error": 1.0, "rows": 3}
    other = {**row, "seed": 1, "relative_error": 2.0}
    third = {**row, "patterns": 32}
    table = means([row, other, third])
    assert [(r["patterns"], r["relative_error"], r["seeds"]) for r in table] == [
        (64, 1.5, 2),
        (32, 1.0, 1),
    ]


def test_an_interrupted_experiment_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = []

    def record(case: Case) -> Measured:
        measured.append(case.name)
        if len(measured) == 2:
            raise KeyboardInterrupt
        return Measured([{**case.__dict__, "relative_error": 0.1}])

    recording = replace(few_patterns.FEW_PATTERNS, measure=record)
    monkeypatch.setitem(EXPERIMENTS, "few-patterns", recording)
    out = tmp_path / "out"
    command = ["experiment", "few-patterns", "--quick", "-o", str(out)]
    assert main(command) == 130
    assert not out.exists()
    assert main(command) == 0
    assert len(measured) == 3
    assert len(set(measured)) == 2
    assert len(json.loads((out / "few-patterns.json").read_text())["rows"]) == 2
    assert not (tmp_path / "out.cases").exists()
