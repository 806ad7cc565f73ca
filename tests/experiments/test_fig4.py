"""The paper's numerical simulation, with few trials."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.experiments import fig4


def _mean(method: str, observations: int, level: float, trials: int = 20) -> float:
    matrices, x = fig4.draw(trials, observations, seed=0)
    return float(fig4.errors(method, matrices, x, level).mean())


def test_draws_follow_the_protocol() -> None:
    matrices, x = fig4.draw(30, 40, seed=3)
    assert matrices.shape == (30, 40, 100)
    assert ((matrices >= 0) & (matrices < 1)).all()
    assert ((x != 0).sum(axis=1) == 10).all()
    assert x.min() >= 0
    assert x.max() < 1


def test_unclipped_the_two_admms_coincide_and_beat_romp() -> None:
    for observations in (40, 90):
        plain = _mean("admm", observations, np.inf)
        saturation = _mean("saturation-admm", observations, np.inf)
        assert abs(plain - saturation) < 0.002
        assert max(plain, saturation) < 0.005
        assert max(plain, saturation) < _mean("romp", observations, np.inf)


def test_clipped_only_the_clip_aware_estimates_converge() -> None:
    saturation = _mean("saturation-admm", 100, fig4.CLIP_LEVEL)
    assert saturation <= 0.02
    assert saturation <= _mean("admm", 100, fig4.CLIP_LEVEL) / 8
    assert _mean("one-sided", 100, fig4.CLIP_LEVEL) <= 0.02


def test_unclipped_the_other_fidelities_are_saturation_admm() -> None:
    """Which is why `measure` does not solve them again."""
    matrices, x = fig4.draw(3, 40, seed=0)
    expected = fig4.errors("saturation-admm", matrices, x, np.inf)
    for name in fig4.SAME_WHERE_UNCLIPPED:
        np.testing.assert_array_equal(fig4.errors(name, matrices, x, np.inf), expected)


def test_the_order_of_methods_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    case = fig4.Case(30, trials=3)
    expected = {(row["method"], row["condition"]): row for row in fig4.measure(case).rows}
    monkeypatch.setattr(fig4, "METHODS", dict(reversed(fig4.METHODS.items())))
    results = {(row["method"], row["condition"]): row for row in fig4.measure(case).rows}
    assert results == expected


def test_files_hold_the_promised_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fig4, "OBSERVATIONS", (10, 20))
    monkeypatch.setattr(fig4, "QUICK_TRIALS", 2)
    seen: list[tuple[int, int]] = []
    fig4.FIG4.run(tmp_path, quick=True, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 2), (2, 2)]
    result = json.loads((tmp_path / "fig4.json").read_text())
    assert {"lambda", "mu", "nu", "trials"} <= result["parameters"].keys()
    assert len(result["rows"]) == 2 * 2 * 5
    keys = ["method", "condition", "observations", "rmse_mean", "rmse_std"]
    assert all(list(row) == keys for row in result["rows"])
    with open(tmp_path / "fig4.csv") as file:
        assert len(list(csv.DictReader(file))) == 20
    for name in ("fig4.png", "fig4.svg"):
        assert (tmp_path / name).stat().st_size > 1000
