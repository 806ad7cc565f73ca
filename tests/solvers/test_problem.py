"""`Problem` refuses invalid input, with a hint."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lightmatrix.errors import InputError
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, SaturationADMM, Status, solve
from tests.helpers.problems import clipping_problem, with_samples


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


def test_the_status_names_the_remedy() -> None:
    problem, _ = clipping_problem()
    result = solve(problem, SaturationADMM(max_iterations=2))
    assert result.status is Status.ITERATION_LIMIT
    assert not result.converged.any()
    assert (result.iterations == 2).all()
    assert "raise the limit" in result.status


def test_the_default_background_column_is_the_means() -> None:
    problem, _ = clipping_problem(seed=5)
    means = problem.patterns.means
    np.testing.assert_array_equal(problem.column, means)
    same = replace(problem, background_column=means)
    for solver in (ActiveSet(), SaturationADMM(), ADMM(), ROMP()):
        one, other = solve(problem, solver), solve(same, solver)
        np.testing.assert_array_equal(one.objective, other.objective)
        np.testing.assert_array_equal(one.background, other.background)
        # Twice the column has half the coefficient.
        double = solve(replace(problem, background_column=2 * means), solver)
        np.testing.assert_allclose(2 * double.background, one.background, rtol=0.05, atol=5e-3)


@pytest.mark.parametrize("column", [np.zeros(3), np.zeros((40, 1)), np.full(40, np.nan)])
def test_bad_columns(column: Any) -> None:
    problem, _ = clipping_problem()
    with pytest.raises(InputError, match="background column"):
        replace(problem, background_column=column)
