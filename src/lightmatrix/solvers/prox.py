"""Soft thresholds: the z-updates of the ADMM solvers (Eq. 12 and 13)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Limit of Newton steps. Each step passes at least one kink of the function, and most pass many.
_NEWTON_STEPS = 100
# Number of rows that are handled at a time in double precision, to save memory.
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
    """Minimise threshold sum z + ||q - z||^2 / 2 + (total - c)^2 / 2 over z >= 0 under a cap.

    The cap is sum z <= scale c (Eq. 13 with the bound b >= 0); q and z are (M, N), total and c
    (M,). Where it binds, thresholds rise by tau and c by scale tau. tau is the root of a convex,
    piecewise linear function, to which Newton's steps from 0 rise without overshoot.
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
