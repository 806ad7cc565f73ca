"""Every fidelity against its definition: value, slope and u-update, by brute force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lightmatrix.errors import InputError, LightMatrixError
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.solvers import ROMP, ActiveSet, Fidelity, SaturationADMM
from lightmatrix.solvers.fidelity import Observed

values = st.floats(-3, 6, allow_nan=False, width=32)
positive = st.floats(0.01, 30)
weights = st.sampled_from([0.0, 0.25, 1.0, 4.0])
EVERY = pytest.mark.parametrize("fidelity", list(Fidelity))


@st.composite
def samples(draw: Any) -> tuple[float, bool, float]:
    """A sample, whether it is clipped, and its clip level."""
    level, clipped = draw(positive), draw(st.booleans())
    return (level if clipped else level * draw(st.floats(0, 1))), clipped, level


def one(y: float, clipped: bool, level: float, weight: float = 1.0) -> Observed:
    def array(value: float) -> np.ndarray:
        return np.array([[value]])

    return Observed(array(y), np.array([[clipped]]), array(level), array(weight))


def term(u: np.ndarray, y: float, clipped: bool, level: float, fidelity: Fidelity) -> np.ndarray:
    """f(u) from its definition in the table of fidelities."""
    if fidelity is Fidelity.CLIPPED:
        return (y - np.minimum(u, y if clipped else level)) ** 2 / 2
    if clipped and fidelity is Fidelity.REJECTION:
        return np.zeros_like(u)
    if clipped and fidelity is Fidelity.ONE_SIDED:
        return np.maximum(0, y - u) ** 2 / 2
    return (y - u) ** 2 / 2


@EVERY
@given(u=values, sample=samples())
@settings(max_examples=100, deadline=None)
def test_values_are_those_of_the_table(
    fidelity: Fidelity, u: float, sample: tuple[float, bool, float]
) -> None:
    cost = fidelity.term.value(np.array([[u]]), one(*sample))
    np.testing.assert_allclose(cost[0], term(np.array([u]), *sample, fidelity), rtol=1e-9)


@EVERY
@given(u=values, sample=samples())
@settings(max_examples=100, deadline=None)
def test_residuals_are_minus_the_slopes(
    fidelity: Fidelity, u: float, sample: tuple[float, bool, float]
) -> None:
    y, clipped, level = sample
    step = 1e-6 * (1 + abs(u))
    # `clipped` has no slope at its kink.
    assume(fidelity is not Fidelity.CLIPPED or abs(u - (y if clipped else level)) > step)
    around = term(np.array([u - step, u + step]), *sample, fidelity)
    slope = (around[1] - around[0]) / (2 * step)
    residual = fidelity.term.residual(np.array([[u]]), one(*sample))
    assert -residual[0, 0] == pytest.approx(slope, rel=1e-4, abs=1e-5 * (1 + level))


@EVERY
@given(v=values, sample=samples(), weight=weights, coupling=positive)
@settings(max_examples=120, deadline=None)
def test_prediction_update_minimises_its_own_problem(
    fidelity: Fidelity, v: float, sample: tuple[float, bool, float], weight: float, coupling: float
) -> None:
    update = updated(v, *sample, weight, coupling, fidelity)
    grid = np.linspace(-10, 40, 200_001)

    def cost(u: np.ndarray) -> np.ndarray:
        return weight * term(u, *sample, fidelity) + coupling / 2 * (v - u) ** 2

    best = cost(grid).min()
    assert cost(np.array([update]))[0] <= best + 1e-6 * (1 + best)


def updated(
    v: float, y: float, clipped: bool, level: float, weight: float, c: float, fidelity: Fidelity
) -> float:
    observed = one(y, clipped, level, weight)
    return float(fidelity.term.update(np.array([[v]]), observed, c)[0, 0])


MAKERS: dict[str, Callable[[str], Any]] = {
    "active set": lambda name: ActiveSet(fidelity=name),
    "Saturation ADMM": lambda name: SaturationADMM(fidelity=name),
    "ROMP": lambda name: ROMP(fidelity=name),
    "coherent": lambda name: CoherentEstimator(fidelity=name),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_name_is_enough_and_a_wrong_one_is_refused(make: Callable[[str], Any]) -> None:
    assert make("rejection").fidelity is Fidelity.REJECTION
    with pytest.raises(InputError, match="a fidelity called 'linar'") as error:
        make("linar")
    assert isinstance(error.value, LightMatrixError)
    for fidelity in Fidelity:
        assert fidelity.value in str(error.value.hint)
