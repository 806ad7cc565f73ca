"""The experiment on shape: its rows, its table and its figure."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.experiments import shape as experiment
from lightmatrix.experiments.harness import Measured, Row
from lightmatrix.experiments.run import EXPERIMENTS
from lightmatrix.uses.shape import Shape


def test_t_is_more_often_right_than_codes_where_surfaces_light_each_other() -> None:
    rows = experiment.measure(experiment.Case("corner", 64, 0, patterns=16)).rows
    found = {row["method"]: row for row in rows}
    assert found["T"]["photographs"] == 16
    # 64 x 64 needs 2 x 6 bits, each with its inverse.
    assert found["Gray, inverse"]["photographs"] == 24
    codes = [row for method, row in found.items() if not method.startswith("T")]
    assert len(codes) == 3
    assert found["T"]["right"] > max(98.5, *(row["right"] for row in codes))
    assert found["T"]["wrong"] < min(1.5, *(row["wrong"] for row in codes))


def test_the_judge_knows_right_from_wrong() -> None:
    truth = lm.truth("l_objects")
    assert truth.depth is not None
    assert truth.geometry is not None
    reference = experiment.Reference.of(truth)
    exact = lm.triangulate(truth.transport(), truth.geometry)

    def judged(depth: np.ndarray) -> Row:
        kept = np.isfinite(depth)
        test = np.where(kept, 0, 1).astype(np.uint8)
        shown = depth.astype(np.float32)
        return reference.judged(
            Shape(shown, exact.points, exact.normals, exact.albedo, exact.uncertainty, test,
                  exact.place, exact.from_line, truth.geometry)  # type: ignore[arg-type]
        )  # fmt: skip

    perfect = judged(truth.depth)
    # A few pixels see surfaces that none of the points within them meets.
    assert perfect["right"] > 99.5
    assert perfect["wrong"] < 0.5
    far = truth.depth.copy()
    far[:32] *= 1.2
    half = judged(far)
    assert half["wrong"] == pytest.approx(50, abs=3)
    assert 40 < half["right"] < 60
    far[:32] = np.nan
    assert judged(far)["wrong"] < 0.5


def test_table_and_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [
        {
            "scene": "corner", "size": 64, "rig": "usual", "method": method, "photographs": 28,
            "seed": seed, "right": 90.0 + seed, "wrong": 1.0, "rms": 5.0,
        }
        for method in ("T", "Gray, inverse")
        for seed in (0, 1)
    ]  # fmt: skip
    measured = Measured(rows)
    replaced = EXPERIMENTS["shape"].__class__(
        "shape",
        lambda _: [experiment.Case("corner", 64, 0)],
        lambda _: measured,
        EXPERIMENTS["shape"].draw,
        summary=EXPERIMENTS["shape"].summary,
    )
    monkeypatch.setitem(EXPERIMENTS, "shape", replaced)
    assert main(["experiment", "shape", "--quick", "-o", str(tmp_path / "out")]) == 0
    content = json.loads((tmp_path / "out" / "shape.json").read_text())
    assert [row["right"] for row in content["means"]] == [90.5, 90.5]
    with (tmp_path / "out" / "shape.csv").open() as opened:
        assert [row["seeds"] for row in csv.DictReader(opened)] == ["2", "2"]
    assert (tmp_path / "out" / "shape.png").stat().st_size > 10_000


def test_cases_of_a_full_run() -> None:
    cases = list(experiment.cases(quick=False))
    assert len({case.name for case in cases}) == len(cases) == 21
    assert {case.rig for case in cases} == {"usual", "exposed 4 x", "blur 1"}
