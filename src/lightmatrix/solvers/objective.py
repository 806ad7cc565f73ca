"""Objectives and duality gaps, recomputed in float64 from their definitions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.solvers.fidelity import DataTerm, Fidelity, Observed
from lightmatrix.solvers.problem import Problem

# Rows are treated in chunks of so many bytes.
CHUNK_BYTES = 128 << 20


def predictions(
    problem: Problem, coefficients: csr_array, background: NDArray[Any]
) -> NDArray[np.float64]:
    """A x + b m for every row, (M, K) float64."""
    result = np.empty(problem.samples.values.shape)
    for chunk in _chunks(problem):
        rows = coefficients[chunk].toarray().astype(np.float64)
        result[chunk] = problem.patterns.forward(rows)
    if not problem.background:
        return result
    return result + np.outer(np.asarray(background, np.float64), problem.column)


def data_term(
    problem: Problem, u: NDArray[np.float64], fidelity: Fidelity | str
) -> NDArray[np.float64]:
    """sum_k w_k f_k(u_k) of each row, (M,) float64."""
    return _data_term(problem.observed.astype(np.float64), u, Fidelity(fidelity).term)


def objective(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity | str
) -> NDArray[np.float64]:
    """The problem's objective for each row, (M,) float64."""
    u = predictions(problem, coefficients, background)
    return _norm(problem, coefficients) + data_term(problem, u, fidelity)


def relative_gap(
    problem: Problem, coefficients: csr_array, background: NDArray[Any], fidelity: Fidelity | str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Objective P and relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2), each (M,) float64.

    The dual of min lambda ||x||_1 + sum w f(A x + b m) is: maximise sum y theta - w g(theta / w),
    with g the fidelity's `conjugate` (theta^2 / (2 w) in all but one of them), A' theta <= lambda
    (in absolute value if x may be negative), theta >= 0 where one-sided and m' theta <= 0 (= 0 if b
    may be negative). The weighted residual, made feasible by a shift along m and the best scaling,
    is the dual point. NaN where the fidelity is not convex.
    """
    term, seen = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    u = predictions(problem, coefficients, background)
    primal = _norm(problem, coefficients) + _data_term(seen, u, term)
    if not term.convex:
        return primal, np.full(problem.rows, np.nan)
    dual = _dual_value(problem, seen, u, term)
    floor = 1e-6 * (seen.values**2).sum(axis=1) / 2
    scale = np.maximum(np.maximum(primal, floor), np.finfo(np.float64).tiny)
    return primal, (primal - dual) / scale


def _chunks(problem: Problem) -> Iterator[slice]:
    """The rows of a problem, so many at a time as are made dense."""
    size = max(1, CHUNK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        yield slice(start, start + size)


def _norm(problem: Problem, coefficients: csr_array) -> NDArray[np.float64]:
    sums = np.abs(coefficients).sum(axis=1, dtype=np.float64)
    return problem.regularization * np.asarray(sums).ravel()


def _data_term(seen: Observed, u: NDArray[np.float64], term: DataTerm) -> NDArray[np.float64]:
    return np.asarray((seen.weights * term.value(u, seen)).sum(axis=1))


def _dual_value(
    problem: Problem, seen: Observed, u: NDArray[np.float64], term: DataTerm
) -> NDArray[np.float64]:
    theta = seen.weights * term.residual(u, seen)
    if problem.background:
        theta = _orthogonal_to_column(problem, theta, (seen.weights > 0) & term.free(seen))
    highest = np.empty(problem.rows)
    for chunk in _chunks(problem):
        correlations = problem.patterns.adjoint(theta[chunk])
        part = correlations if problem.nonnegative else np.abs(correlations)
        highest[chunk] = part.max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(highest > 0, problem.regularization / highest, np.inf)
    if not term.quadratic:
        return _scaled_down(seen, theta, limit, term)
    linear = (seen.values * theta).sum(axis=1)
    quadratic = _over(theta**2, seen.weights).sum(axis=1)
    # D(s theta) is a parabola in s: take its top, or the largest feasible scaling before it.
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.where(quadratic > 0, linear / quadratic, 0)
    # Far beyond 1 it would only magnify the rounding errors in m' theta = 0.
    scaling = np.clip(top, 0, np.minimum(limit, 2))
    return np.asarray(scaling * linear - scaling**2 * quadratic / 2)


def _scaled_down(
    seen: Observed, theta: NDArray[np.float64], limit: NDArray[np.float64], term: DataTerm
) -> NDArray[np.float64]:
    """The dual value of theta, scaled down until it is feasible."""
    theta = theta * np.minimum(limit, 1)[:, None]
    cost = term.conjugate(_over(theta, seen.weights), seen)
    return np.asarray((seen.values * theta - seen.weights * cost).sum(axis=1))


def _over(numbers: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers over weights; 0 where the weight is."""
    return np.divide(numbers, weights, out=np.zeros_like(numbers), where=weights > 0)


def _orthogonal_to_column(
    problem: Problem, theta: NDArray[np.float64], free: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Shift theta on its free samples until m' theta <= 0, or = 0 if b may be negative."""
    column = problem.column
    excess = theta @ column
    if problem.nonnegative:
        excess = np.maximum(excess, 0)
    energy = free @ column**2
    step = np.divide(excess, energy, out=np.zeros_like(excess), where=energy > 0)
    shifted = theta - step[:, None] * column * free
    # Without free samples only theta = 0 is feasible.
    return np.where((energy <= 0)[:, None] & (excess > 0)[:, None], 0, shifted)
