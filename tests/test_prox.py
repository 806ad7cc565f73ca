"""Closed forms against a grid that never starts from their own answer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import log_ndtr

from lightmatrix.solvers.problem import Fidelity
from lightmatrix.solvers.prox import (
    capped_soft_threshold,
    clip,
    likelihood_update,
    mills,
    soft_threshold,
    update_prediction,
)

values = st.floats(-3, 6, allow_nan=False, width=32)
positive = st.floats(0.01, 30)


def _term(u: np.ndarray, y: float, clipped: bool, level: float, fidelity: Fidelity) -> np.ndarray:
    """f(u) from its definition in the table of fidelities."""
    if fidelity is Fidelity.CLIPPED:
        return (y - np.minimum(u, y if clipped else level)) ** 2 / 2
    if clipped and fidelity is Fidelity.REJECTION:
        return np.zeros_like(u)
    if clipped and fidelity is Fidelity.LIKELIHOOD:
        width = 0.02 * level
        return -(width**2) * log_ndtr((u - y) / width)
    if clipped and fidelity is Fidelity.ONE_SIDED:
        return np.maximum(0, y - u) ** 2 / 2
    return (y - u) ** 2 / 2


@pytest.mark.parametrize("fidelity", list(Fidelity))
@given(v=values, level=positive, below=st.floats(0, 1), clipped=st.booleans(),
       weight=st.sampled_from([0.0, 0.25, 1.0, 4.0]), coupling=positive)  # fmt: skip
@settings(max_examples=120, deadline=None)
def test_prediction_update_minimises_its_own_problem(
    fidelity: Fidelity,
    v: float,
    level: float,
    below: float,
    clipped: bool,
    weight: float,
    coupling: float,
) -> None:
    y = level if clipped else level * below
    found = _update(v, y, clipped, level, weight, coupling, fidelity)
    grid = np.linspace(-10, 40, 200_001)

    def cost(u: np.ndarray) -> np.ndarray:
        return weight * _term(u, y, clipped, level, fidelity) + coupling / 2 * (v - u) ** 2

    best = cost(grid).min()
    assert cost(np.array([found]))[0] <= best + 1e-6 * (1 + best)


def _update(
    v: float, y: float, clipped: bool, level: float, weight: float, c: float, fidelity: Fidelity
) -> float:
    def one(value: float) -> np.ndarray:
        return np.array([[value]])

    arrays = one(v), one(y), np.array([[clipped]]), one(level), one(weight)
    return float(update_prediction(*arrays, c, fidelity, one(0.02 * level))[0, 0])


@given(v=st.floats(-50, 50), y=st.floats(0, 3), ratio=st.floats(1e-3, 1e3),
       width=st.floats(1e-2, 1))  # fmt: skip
@settings(max_examples=200, deadline=None)
def test_likelihood_update_is_stationary_in_both_tails(
    v: float, y: float, ratio: float, width: float
) -> None:
    """The slope of the cost changes its sign within rounding of the answer."""
    given = np.array([v]), np.array([y]), np.array([ratio])
    u = float(likelihood_update(*given, 1.0, np.array([width]))[0])
    assert u >= v - 1e-9 * (1 + abs(v))

    def slope(u: float) -> float:
        z = (u - y) / width
        # Another way to the Mills ratio: the quotient of its definition, by logarithms.
        ratio_of = np.exp(-(z**2) / 2 - np.log(2 * np.pi) / 2 - log_ndtr(z))
        return float(u - v - ratio * width * ratio_of)

    step = 1e-6 * (1 + abs(u) + abs(v))
    assert slope(u - step) < 0 < slope(u + step)


def test_a_narrow_edge_is_the_one_sided_term() -> None:
    random = np.random.default_rng(0)
    v, y = random.uniform(-3, 6, (2, 1, 500))
    arrays = v, np.abs(y), np.ones(y.shape, bool), np.abs(y), np.ones(y.shape)
    soft = update_prediction(*arrays, 0.7, Fidelity.LIKELIHOOD, np.full(y.shape, 1e-4))
    hard = update_prediction(*arrays, 0.7, Fidelity.ONE_SIDED)
    np.testing.assert_allclose(soft, hard, atol=2e-4)
    assert (soft >= hard - 1e-12).all()


def test_mills_ratio_in_both_tails() -> None:
    np.testing.assert_allclose(mills(np.array([0.0])), np.sqrt(2 / np.pi), rtol=1e-14)
    np.testing.assert_allclose(mills(np.array([-1e6])), 1e6, rtol=1e-11)
    assert mills(np.array([50.0]))[0] == 0


@given(v=values, y=st.floats(0, 3), lam=positive, nu=positive)
@settings(max_examples=200, deadline=None)
def test_equation_19_as_it_is_printed(v: float, y: float, lam: float, nu: float) -> None:
    """For weight 1 the update is Eq. 19 to the letter, at y = Y too."""
    for level in (3.0, y):
        threshold = y + np.sqrt(1 + 1 / (lam * nu)) * (level - y)
        expected = (y + lam * nu * v) / (1 + lam * nu) if v <= threshold else v
        found = _update(v, y, False, level, 1.0, lam * nu, Fidelity.CLIPPED)
        assert found == pytest.approx(expected, abs=1e-9) or v == pytest.approx(threshold)


@given(q=values, threshold=positive, nonnegative=st.booleans())
@settings(max_examples=120, deadline=None)
def test_soft_threshold_minimises_its_own_problem(
    q: float, threshold: float, nonnegative: bool
) -> None:
    found = float(soft_threshold(np.array([q]), threshold, nonnegative=nonnegative)[0])
    grid = np.linspace(0 if nonnegative else -40, 40, 160_001)

    def cost(z: np.ndarray) -> np.ndarray:
        return threshold * np.abs(z) + (q - z) ** 2 / 2

    assert not (nonnegative and found < 0)
    assert cost(np.array([found]))[0] <= cost(grid).min() + 1e-7


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

    # For given z the best c is the total, or what the cap asks for.
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


def test_clipping_function() -> None:
    np.testing.assert_array_equal(clip(np.array([-1.0, 2.0, 3.0, 5.0]), 3.0), [-1, 2, 3, 3])
