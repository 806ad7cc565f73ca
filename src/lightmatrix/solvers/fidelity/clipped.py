"""``clipped``: the camera's clipping inside the data term, as in the paper (Eq. 5 and 6)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import SolverError
from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, met


class Clipped(DataTerm):
    """f(u) = (y - min(u, Y))^2 / 2, with Y = y for clipped samples; convex only where y = Y.

    A sample marked as clipped is a lower bound of its own value, whatever the nominal level.
    """

    name = "clipped"
    convex = False
    quadratic = False

    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return (seen.values - np.minimum(u, _level(seen))) ** 2 / 2

    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return np.where(u < _level(seen), seen.values - u, 0)

    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        # Eq. 20-21: beyond the threshold it costs less to leave u clipped at v. With weight w the
        # ratio 1 / (lambda nu) of Eq. 19 becomes w / (lambda nu), and the two branches cost the
        # same at y + sqrt(1 + w / c) (Y - y).
        y = seen.values
        with np.errstate(divide="ignore"):
            reach = np.sqrt(1 + seen.weights / coupling)
        return np.where(v > y + reach * (_level(seen) - y), v, met(v, seen, coupling))

    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        raise SolverError(
            "the fidelity clipped is not convex: a dual value would prove nothing",
            hint="use one-sided, its convex part",
        )


def _level(seen: Observed) -> NDArray[Any]:
    """The value from which on a prediction counts as clipped."""
    return np.where(seen.clipped, seen.values, np.maximum(seen.clip_level, seen.values))
