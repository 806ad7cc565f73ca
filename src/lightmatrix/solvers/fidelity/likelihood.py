"""The fidelity ``likelihood``: the probability that a noisy sample clips (Banerjee et al. 2021)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, log_ndtr

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, quadratic_update

# Limit of Newton steps. They converge quadratically, so that a handful are enough.
_NEWTON_STEPS = 100
# Newton's method stops at steps below this, relative to 1 + |z|: some thousand times the rounding.
_CONVERGED = 1e-12


class Likelihood(DataTerm):
    """f(u) = (y - u)^2 / 2, or -s^2 log Phi((u - y) / s) if clipped; `OneSided` as s goes to 0."""

    name = "likelihood"
    quadratic = False

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        difference = observed.values - u
        cost = -(observed.edge**2) * log_ndtr(-difference / observed.edge)
        return np.where(observed.clipped, cost, difference**2 / 2)

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        slope = observed.edge * mills((u - observed.values) / observed.edge)
        return np.where(observed.clipped, slope, observed.values - u)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        u = quadratic_update(v, observed, coupling)
        at = np.nonzero(observed.clipped)
        clipped = observed.at(at)
        u[at] = edge_update(v[at], clipped.values, clipped.weights, coupling, clipped.edge)
        return u

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        cost = t**2 / 2
        at = np.nonzero(observed.clipped)
        edge = observed.edge[at]
        # Predictions above the clip level cost nothing, so for t < 0 there is no maximum.
        cost[at] = np.where(t[at] < 0, np.inf, edge**2 * _edge_conjugate(t[at] / edge))
        return cost

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


def mills(z: NDArray[Any]) -> NDArray[np.float64]:
    """phi(z) / Phi(z), minus the slope of -log Phi: about -z far below 0, about 0 far above."""
    return np.asarray(np.sqrt(2 / np.pi) / erfcx(np.asarray(z, np.float64) / -np.sqrt(2)))


def edge_update(
    v: NDArray[Any],
    y: NDArray[Any],
    weights: NDArray[Any],
    coupling: float,
    width: NDArray[Any],
) -> NDArray[Any]:
    """argmin_u -w s^2 log Phi((u - y) / s) + coupling (v - u)^2 / 2, element by element.

    With z = (u - y) / s, the slope over s is coupling (z - z_v) - w mills(z). It increases and is
    concave in z, since the Mills ratio is convex, so Newton's steps from below the root rise to it
    and never pass it. They start at the root for max(0, -z) <= mills(z), the one-sided solution.
    """
    ratio = np.asarray(weights, np.float64) / coupling
    target = (np.asarray(v, np.float64) - y) / width
    z = np.where(target > 0, target, target / (1 + ratio))
    for _ in range(_NEWTON_STEPS):
        slope = mills(z)
        step = (target - z + ratio * slope) / (1 + ratio * slope * np.maximum(z + slope, 0))
        z = z + step
        if _converged(step, z):
            break
    return np.asarray(y + width * z, v.dtype)


def _edge_conjugate(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maximum over z of log Phi(z) - t z for t >= 0, which lies at mills(z) = t.

    log mills is concave and decreasing, so Newton's steps from the right of the root stay there.
    """
    t = np.maximum(t, 0)
    target = np.log(np.maximum(t, np.finfo(np.float64).tiny))
    # mills(z) <= exp(-z^2 / 2) for z >= 0 and <= 1 - z for z <= 0, so the start lies right of the
    # root.
    z = np.where(target < 0, np.sqrt(np.maximum(-2 * target, 0)), 1 - t)
    for _ in range(_NEWTON_STEPS):
        # log mills(z), in a form that neither underflows nor cancels.
        right = -(z**2 + np.log(2 * np.pi)) / 2 - log_ndtr(z)
        logarithm = np.where(z > 0, right, np.log(mills(np.minimum(z, 0))))
        step = (logarithm - target) / (z + mills(z))
        z = z + step
        if _converged(step, z):
            break
    return np.asarray(np.where(t > 0, log_ndtr(z) - t * z, 0))


def _converged(step: NDArray[np.float64], z: NDArray[np.float64]) -> bool:
    return bool((np.abs(step) <= _CONVERGED * (1 + np.abs(z))).all())
