"""Objectives and duality gaps, computed in float64 from their definitions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.solvers.fidelity import DataTerm, Fidelity, Observed
from lightmatrix.solvers.problem import Problem

# Bytes of the dense rows that are handled at a time: little beside a tile, and few Python calls.
CHUNK_BYTES = 128 << 20
# The gap is relative to the objective, but at least to this share of ||y||^2 / 2, so that rows
# without light can converge. The compiled solver uses the same share.
_FLOOR_SHARE = 1e-6
# Limit of the factor that scales the dual point. Near the optimum the best factor is 1; a much
# larger one would only magnify the rounding errors in m' theta = 0.
_LARGEST_SCALING = 2


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
    with g the fidelity's `conjugate`, subject to A' theta <= lambda (in absolute value if x may be
    negative), theta >= 0 where one-sided, and m' theta <= 0 (= 0 if b may be negative). The dual
    point is the weighted residual, shifted along m and scaled to be feasible. A fidelity that is
    not convex has the gap NaN.
    """
    term, observed = Fidelity(fidelity).term, problem.observed.astype(np.float64)
    u = predictions(problem, coefficients, background)
    primal = _norm(problem, coefficients) + _data_term(observed, u, term)
    if not term.convex:
        return primal, np.full(problem.rows, np.nan)
    dual = _dual_value(problem, observed, u, term)
    floor = _FLOOR_SHARE * (observed.values**2).sum(axis=1) / 2
    scale = np.maximum(np.maximum(primal, floor), np.finfo(np.float64).tiny)
    return primal, (primal - dual) / scale


def _chunks(problem: Problem) -> Iterator[slice]:
    """Slices of the rows whose dense coefficients take up to `CHUNK_BYTES`."""
    size = max(1, CHUNK_BYTES // (8 * problem.patterns.pixels))
    for start in range(0, problem.rows, size):
        yield slice(start, start + size)


def _norm(problem: Problem, coefficients: csr_array) -> NDArray[np.float64]:
    sums = np.abs(coefficients).sum(axis=1, dtype=np.float64)
    return problem.regularization * np.asarray(sums).ravel()


def _data_term(observed: Observed, u: NDArray[np.float64], term: DataTerm) -> NDArray[np.float64]:
    return np.asarray((observed.weights * term.value(u, observed)).sum(axis=1))


def _dual_value(
    problem: Problem, observed: Observed, u: NDArray[np.float64], term: DataTerm
) -> NDArray[np.float64]:
    theta = observed.weights * term.residual(u, observed)
    if problem.background:
        theta = _orthogonal_to_column(
            problem, theta, (observed.weights > 0) & term.two_sided(observed)
        )
    highest = np.empty(problem.rows)
    for chunk in _chunks(problem):
        correlations = problem.patterns.adjoint(theta[chunk])
        part = correlations if problem.nonnegative else np.abs(correlations)
        highest[chunk] = part.max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(highest > 0, problem.regularization / highest, np.inf)
    if not term.quadratic:
        return _scaled_down(observed, theta, limit, term)
    linear = (observed.values * theta).sum(axis=1)
    quadratic = _over(theta**2, observed.weights).sum(axis=1)
    # D(s theta) is a parabola in s. Take its top, or the largest feasible scaling below it.
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.where(quadratic > 0, linear / quadratic, 0)
    scaling = np.clip(top, 0, np.minimum(limit, _LARGEST_SCALING))
    return np.asarray(scaling * linear - scaling**2 * quadratic / 2)


def _scaled_down(
    observed: Observed, theta: NDArray[np.float64], limit: NDArray[np.float64], term: DataTerm
) -> NDArray[np.float64]:
    """The dual value of theta, scaled down until it is feasible."""
    theta = theta * np.minimum(limit, 1)[:, None]
    cost = term.conjugate(_over(theta, observed.weights), observed)
    return np.asarray((observed.values * theta - observed.weights * cost).sum(axis=1))


def _over(numbers: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers divided by weights; 0 where the weight is 0."""
    return np.divide(numbers, weights, out=np.zeros_like(numbers), where=weights > 0)


def _orthogonal_to_column(
    problem: Problem, theta: NDArray[np.float64], two_sided: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Shift theta on the two-sided samples until m' theta <= 0, or = 0 if b may be negative."""
    column = problem.column
    excess = theta @ column
    if problem.nonnegative:
        excess = np.maximum(excess, 0)
    energy = two_sided @ column**2
    step = np.divide(excess, energy, out=np.zeros_like(excess), where=energy > 0)
    shifted = theta - step[:, None] * column * two_sided
    # Without two-sided samples only theta = 0 is feasible.
    return np.where((energy <= 0)[:, None] & (excess > 0)[:, None], 0, shifted)
