"""A problem refuses what no solver could treat, and says what would work."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import clipping_problem, with_samples

from lightmatrix.errors import InputError
from lightmatrix.solvers import SaturationADMM, Status, solve


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.zeros((6, 3))}, "40 patterns"),
        ({"values": np.zeros((6, 40), int)}, "float32"),
        ({"values": np.full((6, 40), np.nan)}, "camera row 0, pattern 0"),
        ({"clipped": np.zeros((6, 40))}, "one boolean for each"),
        ({"clip_level": np.ones(3)}, "clip_level"),
        ({"weights": np.ones((6, 3))}, "weights"),
        ({"weights": np.full(40, -1.0)}, "negative"),
    ],
)
def test_bad_samples(change: dict[str, Any], message: str) -> None:
    problem, _ = clipping_problem()
    with pytest.raises(InputError, match=message):
        with_samples(problem, **change)


@pytest.mark.parametrize("regularization", [0.0, float("nan"), float("inf")])
def test_bad_regularization(regularization: float) -> None:
    problem, _ = clipping_problem()
    with pytest.raises(InputError, match="positive"):
        replace(problem, regularization=regularization)


def test_status_tells_the_remedy() -> None:
    problem, _ = clipping_problem()
    result = solve(problem, SaturationADMM(max_iterations=2))
    assert result.status is Status.ITERATION_LIMIT
    assert not result.converged.any()
    assert (result.iterations == 2).all()
    assert "raise the limit" in result.status


def test_progress_counts_finished_rows() -> None:
    problem, _ = clipping_problem()
    seen: list[tuple[int, int]] = []
    solve(problem, SaturationADMM(), progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (problem.rows, problem.rows)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_history_is_kept() -> None:
    problem, _ = clipping_problem()
    result = solve(problem, SaturationADMM())
    assert len(result.history["primal"]) == result.iterations.max()
    assert result.history["rows"][0] == problem.rows
