"""The fidelity ``clipped``: clipping within the data term (the paper's Eq. 5 and 6)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import SolverError
from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, quadratic_update


class Clipped(DataTerm):
    """f(u) = (y - min(u, Y))^2 / 2, where Y = y for clipped samples; convex only if y = Y."""

    name = "clipped"
    convex = False
    quadratic = False

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return (observed.values - np.minimum(u, _level(observed))) ** 2 / 2

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(u < _level(observed), observed.values - u, 0)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        # Eq. 20-21: beyond a threshold, leaving the prediction clipped at u = v costs less. With a
        # weight w, 1 / (lambda nu) of Eq. 19 becomes w / (lambda nu) = w / c, and the threshold is
        # y + sqrt(1 + w / c) (Y - y).
        y = observed.values
        with np.errstate(divide="ignore"):
            factor = np.sqrt(1 + observed.weights / coupling)
        clipped = v > y + factor * (_level(observed) - y)
        return np.where(clipped, v, quadratic_update(v, observed, coupling))

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        raise SolverError(
            "the fidelity clipped is not convex, so there is no dual value",
            hint="use one-sided, its convex part",
        )


def _level(observed: Observed) -> NDArray[Any]:
    """The prediction from which a sample counts as clipped: its own value, a lower bound."""
    above = np.maximum(observed.clip_level, observed.values)
    return np.where(observed.clipped, observed.values, above)
