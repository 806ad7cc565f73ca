"""``rejection``: clipped samples are left out (Laska et al. 2009)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, met


class Rejection(DataTerm):
    """f(u) = (y - u)^2 / 2, and 0 for clipped samples."""

    name = "rejection"
    least_squares = True

    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return self.residual(u, seen) ** 2 / 2

    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return np.where(seen.clipped, 0, seen.values - u)

    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        return np.where(seen.clipped, v, met(v, seen, coupling))

    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return np.where(seen.clipped & (t != 0), np.inf, t**2 / 2)

    def counted(self, seen: Observed) -> NDArray[np.bool_]:
        return ~seen.clipped

    def free(self, seen: Observed) -> NDArray[np.bool_]:
        return ~seen.clipped
