"""An independent reference solver of single rows, slow and in float64.

It shares no code with the package's solvers. It runs SciPy's bound-constrained quasi-Newton method
on a growing set of pixels, and checks all pixels with the dense patterns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

# Limit of rounds. A round adds this many pixels to the set. Both are generous: time does not
# matter.
_ROUNDS = 200
_NEW_PIXELS = 200


@dataclass(frozen=True)
class Reference:
    """The objective of one row, and a lower bound of the optimum."""

    objective: float
    bound: float


def solve_row(
    dense: NDArray[np.float64], y: NDArray[Any], clipped: NDArray[np.bool_], lam: float
) -> Reference:
    """Min over x, b >= 0 of lam sum x + sum f_k(a_k . x + b m_k), one-sided where clipped."""
    means = dense.mean(axis=1)
    y = y.astype(np.float64)
    best = (np.inf, -np.inf)
    pixels = np.array([], np.int64)
    v = np.zeros(1)
    for _ in range(_ROUNDS):
        matrix = np.column_stack([means, dense[:, pixels]])
        price = np.concatenate([[0.0], np.full(len(pixels), lam)])
        v = _minimise(matrix, price, y, clipped, v)
        r = y - matrix @ v
        theta = np.where(clipped, np.maximum(r, 0), r)
        objective = float(price @ v + theta @ theta / 2)
        correlations = dense.T @ theta
        best = _improved(best, objective, theta, y, means, correlations, clipped, lam)
        if objective - best[1] <= 1e-9 * max(objective, 1e-12):
            break
        correlations[pixels] = -np.inf
        new = np.argsort(correlations)[-_NEW_PIXELS:]
        new = new[correlations[new] > 0.98 * lam]
        kept = v[1:] > 0
        pixels = np.concatenate([pixels[kept], new])
        v = np.concatenate([v[:1], v[1:][kept], np.zeros(len(new))])
    return Reference(*best)


def _improved(
    best: tuple[float, float],
    objective: float,
    theta: NDArray[np.float64],
    y: NDArray[np.float64],
    means: NDArray[np.float64],
    correlations: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    lam: float,
) -> tuple[float, float]:
    """The best objective and bound so far, with the bound of theta, scaled to be feasible."""
    two_sided = ~clipped
    excess, energy = max(float(theta @ means), 0.0), float((means[two_sided] ** 2).sum())
    if excess > 0 and energy > 0:
        # Patterns are not negative, so subtracting light only lowers correlations.
        theta = theta - excess / energy * means * two_sided
    scale = min(1.0, lam / max(float(correlations.max()), 1e-300))
    bound = float(scale * (y @ theta) - scale**2 * (theta @ theta) / 2)
    return min(best[0], objective), max(best[1], bound)


def _minimise(
    matrix: NDArray[np.float64],
    price: NDArray[np.float64],
    y: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    v: NDArray[np.float64],
) -> NDArray[np.float64]:
    def value(v: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        r = y - matrix @ v
        r = np.where(clipped, np.maximum(r, 0), r)
        return float(price @ v + r @ r / 2), price - matrix.T @ r

    limits = {"maxiter": 3000, "maxfun": 6000, "ftol": 1e-17, "gtol": 1e-10, "maxcor": 40}
    bounds = [(0, None)] * len(v)
    return minimize(value, v, jac=True, method="L-BFGS-B", bounds=bounds, options=limits).x
