"""``one-sided``: a clipped sample is a lower bound (Rencker et al. 2018, declipping)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, met


class OneSided(DataTerm):
    """f(u) = (y - u)^2 / 2, and max(0, y - u)^2 / 2 for clipped samples."""

    name = "one-sided"

    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return self.residual(u, seen) ** 2 / 2

    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        short = seen.values - u
        return np.where(seen.clipped, np.maximum(short, 0), short)

    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        return np.where(seen.clipped & (v > seen.values), v, met(v, seen, coupling))

    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return np.where(seen.clipped & (t < 0), np.inf, t**2 / 2)

    def free(self, seen: Observed) -> NDArray[np.bool_]:
        return ~seen.clipped
