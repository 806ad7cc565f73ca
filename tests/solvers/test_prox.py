"""Soft thresholds against a grid search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.solvers.admm import capped_soft_threshold, soft_threshold

values = st.floats(-3, 6, allow_nan=False, width=32)
positive = st.floats(0.01, 30)


@given(q=values, threshold=positive, nonnegative=st.booleans())
@settings(max_examples=120, deadline=None)
def test_soft_threshold_minimises_its_own_problem(
    q: float, threshold: float, nonnegative: bool
) -> None:
    shrunk = float(soft_threshold(np.array([q]), threshold, nonnegative=nonnegative)[0])
    grid = np.linspace(0 if nonnegative else -40, 40, 160_001)

    def cost(z: np.ndarray) -> np.ndarray:
        return threshold * np.abs(z) + (q - z) ** 2 / 2

    assert not (nonnegative and shrunk < 0)
    assert cost(np.array([shrunk]))[0] <= cost(grid).min() + 1e-7


@given(q=st.tuples(values, values), total=values, threshold=positive, scale=st.floats(0.2, 5))
@settings(max_examples=100, deadline=None)
def test_capped_soft_threshold_minimises_its_own_problem(
    q: tuple[float, float], total: float, threshold: float, scale: float
) -> None:
    z, c = capped_soft_threshold(np.array([q]), np.array([total]), threshold, scale)
    assert (z >= 0).all()
    assert z.sum() <= scale * c[0] + 1e-9
    axis = np.linspace(0, 6, 801)
    one, two = np.meshgrid(axis, axis)

    def cost(one: np.ndarray, two: np.ndarray, c: np.ndarray) -> np.ndarray:
        distance = (one - q[0]) ** 2 + (two - q[1]) ** 2 + (c - total) ** 2
        return threshold * (one + two) + distance / 2

    # For a fixed z, the best c is the total, or the smallest that the cap allows.
    best = cost(one, two, np.maximum(total, (one + two) / scale)).min()
    assert cost(z[0, 0], z[0, 1], c[0]) <= best + 1e-9


def test_capped_soft_threshold_raises_all_thresholds_of_a_row_alike() -> None:
    random = np.random.default_rng(0)
    q = 3 * random.standard_normal((40, 300))
    total = 500 + 100 * random.standard_normal(40)
    z, c = capped_soft_threshold(q, total, 0.1, 0.7)
    plain = soft_threshold(q, 0.1, nonnegative=True)
    free = plain.sum(axis=1) <= 0.7 * total
    assert 0 < free.sum() < 40
    np.testing.assert_array_equal(z[free], plain[free])
    np.testing.assert_array_equal(c[free], total[free])
    for row in np.flatnonzero(~free):
        tau = (c[row] - total[row]) / 0.7
        assert tau > 0
        np.testing.assert_allclose(z[row], np.maximum(q[row] - 0.1 - tau, 0), atol=1e-9)
        assert z[row].sum() == pytest.approx(0.7 * c[row])
