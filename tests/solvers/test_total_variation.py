"""Total variation: against a smooth solver that shares nothing with it, also where samples clip."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import lightmatrix as lm
from lightmatrix.solvers.total_variation import TotalVariation

SHAPE = (6, 7)


def objective(x: Any, matrix: Any, values: Any, clipped: Any, penalty: float, round: float) -> Any:
    """The definition, and its slope, with corners that are rounded a little."""
    image = x.reshape(SHAPE)
    down, right = np.zeros(SHAPE), np.zeros(SHAPE)
    down[:-1], right[:, :-1] = image[1:] - image[:-1], image[:, 1:] - image[:, :-1]
    length = np.sqrt(down**2 + right**2 + round**2)
    off = matrix @ x - values
    off[clipped] = np.minimum(off[clipped], 0)
    slope = np.zeros(SHAPE)
    slope -= (down + right) / length
    slope[1:] += (down / length)[:-1]
    slope[:, 1:] += (right / length)[:, :-1]
    value = penalty * length.sum() + off @ off / 2
    return value, penalty * slope.ravel() + matrix.T @ off


@pytest.mark.parametrize("clips", [False, True])
def test_the_objective_is_as_low_as_that_of_another_solver(clips: bool) -> None:
    patterns = lm.BernoulliPatterns(SHAPE, 20, seed=3)
    picture = np.ones(SHAPE)
    picture[2:5, 1:4], picture[:2, 5:] = 3, 0
    values = patterns.forward(picture.reshape(1, -1))
    values += 0.3 * np.random.default_rng(1).standard_normal(values.shape)
    limit = float(np.quantile(values, 0.8 if clips else 1)) + (not clips)
    samples = lm.Samples(np.minimum(values, limit), values >= limit, np.full(20, limit))
    problem = lm.Problem(patterns, samples, 0.5, background=False)
    result = lm.solve(problem, TotalVariation(tolerance=1e-7, max_iterations=20_000))
    assert result.converged.all()
    parts = patterns.dense().astype(float), samples.values[0], samples.clipped[0]
    x = np.ones(patterns.pixels)
    for corner in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        settings = {"maxiter": 20_000, "maxfun": 100_000, "ftol": 1e-15, "gtol": 1e-10}
        bounds = [(0, None)] * patterns.pixels
        x = minimize(
            objective, x, (*parts, 0.5, corner), "L-BFGS-B", True, bounds=bounds, options=settings
        ).x
    other, _ = objective(x, *parts, 0.5, 1e-12)
    own, _ = objective(result.coefficients.toarray()[0], *parts, 0.5, 1e-12)
    assert own == pytest.approx(float(result.objective[0]), rel=1e-6)
    assert own < other * (1 + 1e-5)
    assert np.abs(result.coefficients.toarray()[0] - x).max() < 0.02
    assert clips == bool((patterns.forward(x[None]) > limit).any())


def test_rows_do_not_depend_on_each_other_much() -> None:
    patterns = lm.BernoulliPatterns(SHAPE, 30)
    pictures = np.random.default_rng(0).random((3, patterns.pixels))
    values = patterns.forward(pictures)
    samples = lm.Samples(values, values > 99, np.full(30, 99.0))
    solver = TotalVariation(tolerance=1e-7, max_iterations=20_000)
    together = lm.solve(lm.Problem(patterns, samples, 0.1), solver).coefficients.toarray()
    alone = lm.solve(lm.Problem(patterns, samples.rows(slice(1, 2)), 0.1), solver)
    np.testing.assert_allclose(together[1], alone.coefficients.toarray()[0], atol=1e-3)
