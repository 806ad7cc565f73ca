"""Objectives and duality gaps, recomputed in float64 from their definitions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import log_ndtr

from lightmatrix.solvers.problem import Fidelity, Problem
from lightmatrix.solvers.prox import mills

_BLOCK_BYTES = 128 << 20
# Quadratic convergence: a handful suffice.
_NEWTON_STEPS = 50


def predictions(
    problem: Problem, coefficients: csr_array, background: NDArray[Any]
) -> NDArray[np.float64]:
    """A x + b m for every row, (M, K) float64."""
    result = np.empty(problem.samples.values.shape)
    size = max(1, _BLOCK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        rows = coefficients[start : start + size].toarray().astype(np.float64)
        result[start : start + size] = problem.patterns.forward(rows)
    return result + np.outer(np.asarray(background, np.float64), problem.patterns.means)


def data_term(problem: Problem, u: NDArray[np.float64], fidelity: Fidelity) -> NDArray[np.float64]:
    """sum_k w_k f_k(u_k) of each row, (M,) float64."""
    y = problem.samples.values.astype(np.float64)
    weights = problem.samples.weights_of_all().astype(np.float64)
    residual = y - u
    if fidelity is Fidelity.ONE_SIDED:
        residual = np.where(problem.samples.clipped, np.maximum(residual, 0), residual)
    elif fidelity is Fidelity.REJECTION:
        residual = np.where(problem.samples.clipped, 0, residual)
    elif fidelity is Fidelity.CLIPPED:
        level = np.maximum(problem.samples.clip_levels_of_all().astype(np.float64), y)
        level = np.where(problem.samples.clipped, y, level)
        residual = y - np.minimum(u, level)
    terms = residual**2 / 2
    if fidelity is Fidelity.LIKELIHOOD:
        width = problem.edge_widths().astype(np.float64)
        terms = np.where(problem.samples.clipped, -(width**2) * log_ndtr(-residual / width), terms)
    return np.asarray((weights * terms).sum(axis=1))


def objective(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity
) -> NDArray[np.float64]:
    """The problem's objective for each row, (M,) float64."""
    u = predictions(problem, coefficients, background)
    return _norm(problem, coefficients) + data_term(problem, u, fidelity)


def relative_gap(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Objective P and relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2), each (M,) float64.

    The dual of min lambda ||x||_1 + sum w f(A x + b m) is: maximise sum y theta - theta^2 / (2 w)
    with A' theta <= lambda (in absolute value if x may be negative), theta >= 0 where one-sided
    and m' theta <= 0 (= 0 if b may be negative). The weighted residual, made feasible by a shift
    along m and the best scaling, is the dual point. NaN where the fidelity is not convex.

    For a clipped sample of the likelihood the residual is s mills(z) with z = (u - y) / s, and
    theta^2 / (2 w) becomes w s^2 g(theta / (w s)), g(t) = max over z of log Phi(z) - t z.
    """
    u = predictions(problem, coefficients, background)
    primal = _norm(problem, coefficients) + data_term(problem, u, fidelity)
    if not fidelity.convex:
        return primal, np.full(problem.rows, np.nan)
    dual = _dual_value(problem, u, fidelity)
    y = problem.samples.values.astype(np.float64)
    floor = 1e-6 * (y**2).sum(axis=1) / 2
    scale = np.maximum(np.maximum(primal, floor), np.finfo(np.float64).tiny)
    return primal, (primal - dual) / scale


def _norm(problem: Problem, coefficients: csr_array) -> NDArray[np.float64]:
    sums = np.abs(coefficients).sum(axis=1, dtype=np.float64)
    return problem.regularization * np.asarray(sums).ravel()


def _dual_value(
    problem: Problem, u: NDArray[np.float64], fidelity: Fidelity
) -> NDArray[np.float64]:
    y = problem.samples.values.astype(np.float64)
    weights = problem.samples.weights_of_all().astype(np.float64)
    theta = weights * (y - u)
    free = weights > 0
    if fidelity is Fidelity.ONE_SIDED:
        theta = np.where(problem.samples.clipped, np.maximum(theta, 0), theta)
        free = free & ~problem.samples.clipped
    elif fidelity is Fidelity.REJECTION:
        theta = np.where(problem.samples.clipped, 0, theta)
        free = free & ~problem.samples.clipped
    elif fidelity is Fidelity.LIKELIHOOD:
        width = problem.edge_widths().astype(np.float64)
        slope = width * mills((u - y) / width)
        theta = np.where(problem.samples.clipped, weights * slope, theta)
        free = free & ~problem.samples.clipped
    if problem.background:
        theta = _orthogonal_to_means(problem, theta, free)
    highest = np.empty(problem.rows)
    size = max(1, _BLOCK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        correlations = problem.patterns.adjoint(theta[start : start + size])
        part = correlations if problem.nonnegative else np.abs(correlations)
        highest[start : start + size] = part.max(axis=1)
    if fidelity is Fidelity.LIKELIHOOD:
        return _likelihood_dual(problem, theta, highest)
    linear = (y * theta).sum(axis=1)
    quadratic = np.divide(theta**2, weights, out=np.zeros_like(theta), where=weights > 0).sum(1)
    # D(s theta) is a parabola in s: take its top, or the largest feasible scaling before it.
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.where(quadratic > 0, linear / quadratic, 0)
        limit = np.where(highest > 0, problem.regularization / highest, np.inf)
    # Far beyond 1 it would only magnify the rounding errors in m' theta = 0.
    scaling = np.clip(top, 0, np.minimum(limit, 2))
    return np.asarray(scaling * linear - scaling**2 * quadratic / 2)


def _likelihood_dual(
    problem: Problem, theta: NDArray[np.float64], highest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The dual value of theta, scaled down until it is feasible."""
    weights = problem.samples.weights_of_all().astype(np.float64)
    width = problem.edge_widths().astype(np.float64)
    with np.errstate(divide="ignore"):
        scaling = np.where(highest > 0, problem.regularization / highest, np.inf)
    theta = theta * np.minimum(scaling, 1)[:, None]
    share = np.divide(theta, weights, out=np.zeros_like(theta), where=weights > 0)
    cost = share**2 / 2
    at = np.nonzero(problem.samples.clipped)
    cost[at] = width[at] ** 2 * _log_ndtr_conjugate(share[at] / width[at])
    return np.asarray((problem.samples.values * theta - weights * cost).sum(axis=1))


def _log_ndtr_conjugate(t: NDArray[np.float64]) -> NDArray[np.float64]:
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
        if (np.abs(step) <= 1e-12 * (1 + np.abs(z))).all():
            break
    return np.asarray(np.where(t > 0, log_ndtr(z) - t * z, 0))


def _orthogonal_to_means(
    problem: Problem, theta: NDArray[np.float64], free: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Shift theta on its free samples until m' theta <= 0, or = 0 if b may be negative."""
    means = problem.patterns.means
    excess = theta @ means
    if problem.nonnegative:
        excess = np.maximum(excess, 0)
    energy = free @ means**2
    step = np.divide(excess, energy, out=np.zeros_like(excess), where=energy > 0)
    shifted = theta - step[:, None] * means * free
    # Without free samples only theta = 0 is feasible.
    return np.where((energy <= 0)[:, None] & (excess > 0)[:, None], 0, shifted)
