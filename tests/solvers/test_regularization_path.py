"""The choice of the regularization by hold-out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lightmatrix.errors import InputError
from lightmatrix.solvers import Fidelity
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.regularization import regularization_path
from tests.helpers.problems import clipping_problem, with_samples


def test_the_path_finds_the_scale_of_the_noise() -> None:
    problem, _ = clipping_problem(rows=20, count=80, regularization=0.05)
    path = regularization_path(problem, factors=(100, 1, 0.1), share=0.2)
    assert (np.diff(path.values) < 0).all()
    assert len(path.held_out) == 16
    # At 100 times the regularization all rows are zero.
    assert path.errors[0] > 2 * path.errors.min()
    # The errors are those of the held-out samples, computed from the definition.
    kept = np.setdiff1d(np.arange(80), path.held_out)
    dense = problem.patterns.dense().astype(np.float64)
    fit = replace(
        problem, patterns=problem.patterns.subset(kept), samples=problem.samples.frames(kept)
    )
    seen, clipped = problem.samples.values, problem.samples.clipped
    errors = []
    for value in path.values:
        result = ActiveSet(tolerance=1e-6).solve(replace(fit, regularization=float(value)))
        x, b = result.coefficients.toarray(), result.background
        u = x @ dense.T + np.outer(b, dense.mean(axis=1))
        wrong = np.where(clipped, np.maximum(seen - u, 0), seen - u)[:, path.held_out]
        errors.append(np.sqrt(np.mean(wrong**2)))
    np.testing.assert_allclose(path.errors, errors, rtol=0.02)
    # `best` is the largest value whose error is within 1 % of the least one.
    assert path.best == next(
        v for v, e in zip(path.values, path.errors, strict=True) if e <= 1.01 * min(path.errors)
    )
    assert path.best == path.values[np.argmin(errors)]


@pytest.mark.parametrize("fidelity", [Fidelity.LINEAR, Fidelity.REJECTION])
def test_the_path_works_for_each_fidelity_and_with_weights(fidelity: Fidelity) -> None:
    problem, _ = clipping_problem(rows=3, count=40)
    weights = np.ones(40)
    weights[::3] = 0
    weighted = with_samples(problem, weights=weights)
    path = regularization_path(weighted, solver=ActiveSet(fidelity))
    assert np.isfinite(path.errors).all()


def test_one_pattern_may_be_held_out() -> None:
    problem, _ = clipping_problem(rows=2, count=40)
    assert len(regularization_path(problem, share=1 / 40).held_out) == 1
    with pytest.raises(InputError, match="held out"):
        regularization_path(problem, share=0.4 / 40)


def test_rows_are_spread_evenly_and_the_seed_draws_the_patterns() -> None:
    problem, _ = clipping_problem(rows=9, count=40)
    few = regularization_path(problem.take(np.array([0, 4, 8])), factors=(1,))
    path = regularization_path(problem, factors=(1,), rows=3)
    np.testing.assert_array_equal(path.errors, few.errors)
    other = regularization_path(problem, factors=(1,), rows=3, seed=1)
    assert (other.held_out != path.held_out).any()
    # By default an eighth of the patterns is held out.
    assert len(path.held_out) == problem.patterns.count // 8


@pytest.mark.parametrize(
    "options", [{"factors": ()}, {"factors": (0.0,)}, {"share": 0.0}, {"share": 0.999}, {"rows": 0}]
)
def test_the_path_refuses_what_is_out_of_range(options: dict[str, object]) -> None:
    problem, _ = clipping_problem(rows=2)
    with pytest.raises(InputError):
        regularization_path(problem, **options)  # type: ignore[arg-type]
