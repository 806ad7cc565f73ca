"""The experiment on uses of T: its rows, its table and its figure."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.experiments import uses
from lightmatrix.experiments.run import EXPERIMENTS
from lightmatrix.experiments.uses_compensation import compensation_rows, wanted_picture
from lightmatrix.experiments.uses_separation import separation_rows

SEVEN = {"use", "scene", "size", "method", "metric", "value", "seed"}


def test_compensation_by_an_estimate_is_between_gains_and_the_truth() -> None:
    measured = uses.measure(uses.Case("l_objects", 64, 0))
    assert all(set(row) == SEVEN for row in measured.rows)
    psnr = {row["method"]: row["value"] for row in measured.rows if row["metric"] == "PSNR"}
    assert psnr["pixel gains"] + 4 < psnr["estimate"] < psnr["true T"] + 0.3
    assert psnr["estimate"] > psnr["true T"] - 1.5


def test_the_psnr_is_that_of_photographs_of_the_true_scene() -> None:
    """By the truth instead of an estimate, both methods make the same photograph."""
    truth = lm.truth("metal")
    psnr = {
        row["method"]: row["value"]
        for row in compensation_rows(truth.transport(), truth, "metal")
        if row["metric"] == "PSNR"
    }
    assert psnr["estimate"] == pytest.approx(psnr["true T"], abs=0.05)


def test_separation_beats_its_peers_on_the_same_photographs() -> None:
    truth = lm.truth("l_objects")
    exposure = lm.plan(truth, frames=32).exposure
    capture = lm.simulate(truth, lm.BernoulliPatterns((64, 64), 32), exposure=exposure)
    rows = separation_rows(lm.estimate(capture), truth, "l_objects", seed=0)
    for use in ("separate", "separate, blur 1"):
        for metric in ("direct error", "global error"):
            value = {
                row["method"]: row["value"]
                for row in rows
                if row["use"] == use and row["metric"] == metric
            }
            assert 0 < value["T, separated"] < value["Nayar, best square"]
            assert value["Nayar, best square"] < value["T, window 5 x 5"]
        of_use = [row for row in rows if row["use"] == use and row["method"] == "T, separated"]
        found = {row["metric"]: row["value"] for row in of_use}
        assert found["called direct"] <= 0.05
        assert found["direct lost"] <= 0.003
        assert found["epipolar direction off"] < 1.5


def test_the_wanted_picture_is_of_another_scene() -> None:
    for scene in uses.SCENES:
        picture = wanted_picture(scene, 64)
        own = lm.truth(scene).matrix.sum(axis=1).reshape(64, 64)
        assert abs(np.corrcoef(picture.ravel(), own.ravel())[0, 1]) < 0.5
        assert picture.min() >= 0
        assert picture.max() == 1


def test_the_command_writes_the_table_and_the_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = EXPERIMENTS["uses"]
    monkeypatch.setattr(uses, "SCENES", ("l_objects",))
    assert [case.name for case in experiment.cases(True)] == ["l_objects-64-s0"]
    assert len(list(experiment.cases(False))) == 6
    assert main(["experiment", "uses", "--quick", "-o", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "uses.json").read_text())
    assert {row["use"] for row in result["rows"]} >= {"compensate", "separate"}
    with (tmp_path / "out" / "uses.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(result["means"])
    assert lm.read_image(tmp_path / "out" / "uses.png").ndim == 3
