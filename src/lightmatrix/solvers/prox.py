"""Element-wise minimisations: thresholding (Eq. 12) and the u-updates (Eq. 18-21, and others).

All are pure functions of arrays; each is held against a grid search in the tests.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcx

from lightmatrix.errors import SolverError
from lightmatrix.solvers.problem import Fidelity

# Far more than are ever needed: each step passes at least one kink, and most pass many.
_NEWTON_STEPS = 100
# Rows treated at a time, in double precision.
_CAPPED_ROWS = 64


def soft_threshold(
    q: NDArray[Any], threshold: ArrayLike, *, nonnegative: bool = False
) -> NDArray[Any]:
    """argmin_z threshold |z| + (q - z)^2 / 2 (Eq. 12), over z >= 0 if `nonnegative`."""
    shrunk = np.maximum(q - threshold, 0)
    return shrunk if nonnegative else shrunk - np.maximum(-q - threshold, 0)


def capped_soft_threshold(
    q: NDArray[Any], total: NDArray[Any], threshold: float, scale: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Soft threshold under a cap: what the bound b >= 0 makes of Eq. 13.

    Minimises threshold sum z + ||q - z||^2 / 2 + (total - c)^2 / 2 over z >= 0, sum z <= scale c.
    Where the cap binds, all thresholds rise by one tau per row and c by scale tau; tau is the root
    of a convex, piecewise linear function, to which Newton's steps from 0 rise without overshoot.

    Parameters
    ----------
    q : (M, N)
    total : (M,)
    threshold : float
        > 0.
    scale : float
        > 0.

    Returns
    -------
    z : (M, N)
    c : (M,)
    """
    z, c = soft_threshold(q, threshold, nonnegative=True), total.copy()
    over = np.flatnonzero(z.sum(axis=1) > scale * total)
    for start in range(0, len(over), _CAPPED_ROWS):
        rows = over[start : start + _CAPPED_ROWS]
        tau = _rise(z[rows].astype(np.float64), scale * total[rows].astype(np.float64), scale**2)
        z[rows] = np.maximum(z[rows] - tau[:, None], 0)
        c[rows] = total[rows] + scale * tau
    return z, c


def _rise(z: NDArray[np.float64], cap: NDArray[np.float64], give: float) -> NDArray[np.float64]:
    """The tau of each row with sum max(z - tau, 0) = cap + give tau."""
    tau, left = np.zeros(len(z)), z
    for _ in range(_NEWTON_STEPS):
        excess = left.sum(axis=1) - cap - give * tau
        step = np.maximum(excess / ((left > 0).sum(axis=1) + give), 0)
        tau += step
        if (step <= 1e-12 * tau).all():
            break
        left = np.maximum(z - tau[:, None], 0)
    return tau


def clip(u: NDArray[Any], clip_level: ArrayLike) -> NDArray[Any]:
    """The clipping function C_Y (Eq. 5)."""
    return np.minimum(u, clip_level)


def mills(z: NDArray[Any]) -> NDArray[np.float64]:
    """phi(z) / Phi(z), minus the slope of -log Phi: about -z far below 0, 0 far above."""
    return np.asarray(np.sqrt(2 / np.pi) / erfcx(np.asarray(z, np.float64) / -np.sqrt(2)))


def likelihood_update(
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
        if (np.abs(step) <= 1e-12 * (1 + np.abs(z))).all():
            break
    return np.asarray(y + width * z, v.dtype)


def update_prediction(
    v: NDArray[Any],
    y: NDArray[Any],
    clipped: NDArray[np.bool_],
    clip_level: NDArray[Any],
    weights: NDArray[Any],
    coupling: float,
    fidelity: Fidelity,
    edge_widths: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """argmin_u w f(u) + coupling (v - u)^2 / 2 for every sample.

    For the paper's fidelity `clipped` and w = 1 this is Eq. 18-21, with coupling = lambda nu. A
    sample marked as clipped is a lower bound of its own value, whatever the nominal level.

    Parameters
    ----------
    v : (M, K)
        A x + g / nu.
    y, clipped, clip_level, weights : (M, K)
        As in `Problem`.
    coupling : float
        lambda times nu, > 0.
    fidelity : Fidelity
        The data term f.
    edge_widths : (M, K), optional
        Needed by `likelihood`.
    """
    # The minimiser while the prediction is not clipped: w (y - u) = coupling (u - v).
    met = (weights * y + coupling * v) / (weights + coupling)
    if fidelity is Fidelity.LINEAR:
        return met
    if fidelity is Fidelity.REJECTION:
        return np.where(clipped, v, met)
    if fidelity is Fidelity.ONE_SIDED:
        return np.where(clipped & (v > y), v, met)
    if fidelity is Fidelity.LIKELIHOOD:
        if edge_widths is None:
            raise SolverError("the likelihood needs the width of the clip level's edge")
        u = met.copy()
        at = np.nonzero(clipped)
        u[at] = likelihood_update(v[at], y[at], weights[at], coupling, edge_widths[at])
        return u
    # Eq. 20-21: beyond the threshold it costs less to leave u clipped at v.
    level = np.where(clipped, y, np.maximum(clip_level, y))
    with np.errstate(divide="ignore"):
        reach = np.sqrt(1 + weights / coupling)
        # With weight w the ratio 1 / (lambda nu) of Eq. 19 becomes w / (lambda nu), and the two
        # branches cost the same at y + sqrt(1 + w / c) (Y - y).
    return np.where(v > y + reach * (level - y), v, met)
