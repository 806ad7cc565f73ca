"""The fidelities that are quadratic in the samples that count: linear, one-sided, rejection."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, quadratic_update


class Linear(DataTerm):
    """f(u) = (y - u)^2 / 2, also for clipped samples (the paper's Eq. 2)."""

    name = "linear"
    clip_aware = False
    least_squares = True

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return self.residual(u, observed) ** 2 / 2

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return observed.values - u

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        return quadratic_update(v, observed, coupling)

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return t**2 / 2


class OneSided(Linear):
    """f(u) = (y - u)^2 / 2, and max(0, y - u)^2 / 2 for clipped samples (Rencker et al. 2018)."""

    name = "one-sided"
    clip_aware = True
    least_squares = False

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        difference = observed.values - u
        return np.where(observed.clipped, np.maximum(difference, 0), difference)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        satisfied = observed.clipped & (v > observed.values)
        return np.where(satisfied, v, quadratic_update(v, observed, coupling))

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped & (t < 0), np.inf, t**2 / 2)

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


class Rejection(Linear):
    """f(u) = (y - u)^2 / 2, and 0 for clipped samples (Laska et al. 2009)."""

    name = "rejection"
    clip_aware = True

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped, 0, observed.values - u)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        return np.where(observed.clipped, v, quadratic_update(v, observed, coupling))

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped & (t != 0), np.inf, t**2 / 2)

    def used(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped
