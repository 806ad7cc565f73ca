"""Soft thresholds against a grid search."""

from __future__ import annotations

import numpy as np
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
