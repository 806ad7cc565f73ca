"""``linear``: every sample as it is, clipped or not."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, met


class Linear(DataTerm):
    """f(u) = (y - u)^2 / 2: blind to clipping (the paper's Eq. 2)."""

    name = "linear"
    clip_aware = False
    least_squares = True

    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return (seen.values - u) ** 2 / 2

    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return seen.values - u

    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        return met(v, seen, coupling)

    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        return t**2 / 2
