"""``likelihood``: how likely a sample with noise is to clip (Banerjee et al. 2021)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, log_ndtr

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed, met

# Newton's method converges quadratically: a handful of steps suffice.
_NEWTON_STEPS = 100
_CONVERGED = 1e-12


class Likelihood(DataTerm):
    """f(u) = (y - u)^2 / 2, and -s^2 log Phi((u - y) / s) for clipped samples.

    Phi is the normal distribution function and s the width of the edge. For s to 0 it becomes
    `OneSided`.
    """

    name = "likelihood"
    quadratic = False

    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        short = seen.values - u
        surprise = -(seen.edge**2) * log_ndtr(-short / seen.edge)
        return np.where(seen.clipped, surprise, short**2 / 2)

    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        slope = seen.edge * mills((u - seen.values) / seen.edge)
        return np.where(seen.clipped, slope, seen.values - u)

    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        u = met(v, seen, coupling)
        at = np.nonzero(seen.clipped)
        some = seen.at(at)
        u[at] = edge_update(v[at], some.values, some.weights, coupling, some.edge)
        return u

    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        cost = t**2 / 2
        at = np.nonzero(seen.clipped)
        edge = seen.edge[at]
        # Where predictions may rise at no cost, only t >= 0 has a maximum.
        cost[at] = np.where(t[at] < 0, np.inf, edge**2 * _edge_conjugate(t[at] / edge))
        return cost

    def free(self, seen: Observed) -> NDArray[np.bool_]:
        return ~seen.clipped


def mills(z: NDArray[Any]) -> NDArray[np.float64]:
    """phi(z) / Phi(z), minus the slope of -log Phi: about -z far below 0, 0 far above."""
    return np.asarray(np.sqrt(2 / np.pi) / erfcx(np.asarray(z, np.float64) / -np.sqrt(2)))


def edge_update(
    v: NDArray[Any],
    y: NDArray[Any],
    weights: NDArray[Any],
    coupling: float,
    width: NDArray[Any],
) -> NDArray[Any]:
    """argmin_u -w s^2 log Phi((u - y) / s) + coupling (v - u)^2 / 2, element by element.

    With z = (u - y) / s the slope over s is coupling (z - z_v) - w mills(z), increasing and concave
    in z, since the Mills ratio is convex. Newton's steps from below the root therefore rise to it
    and never pass it; they start at the root for max(0, -z) <= mills(z), the one-sided solution.

    Parameters
    ----------
    v, y, weights, width : (n,)
        Of clipped samples; width is s > 0.
    coupling : float
        > 0.

    Returns
    -------
    (n,), in the dtype of v
    """
    ratio = np.asarray(weights, np.float64) / coupling
    target = (np.asarray(v, np.float64) - y) / width
    z = np.where(target > 0, target, target / (1 + ratio))
    for _ in range(_NEWTON_STEPS):
        slope = mills(z)
        step = (target - z + ratio * slope) / (1 + ratio * slope * np.maximum(z + slope, 0))
        z = z + step
        if _settled(step, z):
            break
    return np.asarray(y + width * z, v.dtype)


def _edge_conjugate(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maximum over z of log Phi(z) - t z for t >= 0: at mills(z) = t.

    log mills is concave and decreasing, so Newton's steps from the right of the root stay there.
    """
    t = np.maximum(t, 0)
    asked = np.log(np.maximum(t, np.finfo(np.float64).tiny))
    # mills(z) <= exp(-z^2 / 2) for z >= 0, and <= 1 - z for z <= 0: neither root lies left of it.
    z = np.where(asked < 0, np.sqrt(np.maximum(-2 * asked, 0)), 1 - t)
    for _ in range(_NEWTON_STEPS):
        # Of mills(z), in the form that neither underflows nor cancels.
        right = -(z**2 + np.log(2 * np.pi)) / 2 - log_ndtr(z)
        logarithm = np.where(z > 0, right, np.log(mills(np.minimum(z, 0))))
        step = (logarithm - asked) / (z + mills(z))
        z = z + step
        if _settled(step, z):
            break
    return np.asarray(np.where(t > 0, log_ndtr(z) - t * z, 0))


def _settled(step: NDArray[np.float64], z: NDArray[np.float64]) -> bool:
    return bool((np.abs(step) <= _CONVERGED * (1 + np.abs(z))).all())
