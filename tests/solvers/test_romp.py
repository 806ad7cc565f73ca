"""ROMP against the same algorithm written out for one row."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.solvers import ROMP, Fidelity, Problem, Status, solve
from lightmatrix.solvers.problem import objective, predictions
from tests.helpers.problems import clipping_problem, with_samples


def _literal(a: Any, y: Any, n: int, rounds: int) -> Any:
    """Needell & Vershynin's steps, one row, no background, signed."""
    chosen: list[int] = []
    x = np.zeros(a.shape[1])
    residual = y.copy()
    for _ in range(rounds):
        if np.linalg.norm(residual) <= 1e-6 * np.linalg.norm(y) or len(chosen) >= 2 * n:
            break
        u = np.abs(a.T @ residual)
        order = [i for i in np.argsort(-u, kind="stable")[:n] if u[i] > 0]
        runs = [[j for j in order[i:] if u[order[i]] <= 2 * u[j]] for i in range(len(order))]
        best = max(runs, key=lambda run: sum(u[j] ** 2 for j in run))
        fresh = [j for j in best if j not in chosen]
        if not fresh:
            break
        chosen += fresh
        x = np.zeros(a.shape[1])
        x[chosen] = np.linalg.lstsq(a[:, chosen], y, rcond=None)[0]
        residual = y - a @ x
    return x


@given(seed=st.integers(0, 10_000), n=st.integers(1, 12), count=st.integers(20, 40))
@settings(max_examples=60, deadline=None)
def test_batched_romp_is_the_literal_algorithm(seed: int, n: int, count: int) -> None:
    random = np.random.default_rng(seed)
    stack = random.random((count, 5, 12)).astype(np.float32)
    patterns = ImagePatterns(stack)
    x = np.zeros((4, 60))
    for row in x:
        row[random.permutation(60)[:4]] = random.standard_normal(4)
    y = patterns.forward(x)
    problem = Problem(
        patterns,
        Samples(y, y > np.inf, np.full(count, np.inf), None),
        1.0,
        nonnegative=False,
        background=False,
    )
    result = solve(problem, ROMP(n, Fidelity.LINEAR))
    matrix = patterns.dense().astype(np.float64)
    for index in range(4):
        expected = _literal(matrix, y[index], n, n)
        row = result.coefficients[[index]].toarray()[0]
        # Nearly singular least squares have many solutions, but the same fit.
        np.testing.assert_allclose(matrix @ row, matrix @ expected, atol=1e-4 * abs(y).max())


def test_rejection_ignores_clipped_samples() -> None:
    problem, _ = clipping_problem(count=60)
    changed = np.where(problem.samples.clipped, 50.0, problem.samples.values)
    one = solve(problem, ROMP())
    two = solve(with_samples(problem, values=changed), ROMP())
    np.testing.assert_array_equal(one.coefficients.toarray(), two.coefficients.toarray())
    np.testing.assert_array_equal(one.background, two.background)


def test_sparse_rows_are_found_exactly() -> None:
    problem, x = clipping_problem(rows=8, shape=(16, 16), count=150, clip_level=50.0)
    result = solve(problem, ROMP(5))
    assert np.linalg.norm(result.coefficients.toarray() - x) < 0.05 * np.linalg.norm(x)
    assert result.background == pytest.approx(0.1, abs=0.05)
    assert (result.coefficients.data >= 0).all()


def test_objective_is_recomputed_from_the_definition() -> None:
    problem, _ = clipping_problem()
    result = solve(problem, ROMP())
    again = objective(problem, result.coefficients, result.background, Fidelity.REJECTION)
    np.testing.assert_allclose(result.objective, again)
    assert np.isnan(result.gap).all()


def test_clipped_and_dark_rows_are_empty() -> None:
    problem, _ = clipping_problem()
    blind = solve(with_samples(problem, clipped=np.ones_like(problem.samples.clipped)), ROMP())
    assert blind.coefficients.nnz == 0
    dark = solve(
        with_samples(problem, values=0 * problem.samples.values), ROMP(fidelity=Fidelity.LINEAR)
    )
    assert dark.coefficients.nnz == 0
    empty = solve(problem.take(np.arange(0)), ROMP())
    assert empty.coefficients.shape == (0, problem.patterns.pixels)


def test_the_status_says_whether_all_rows_converged() -> None:
    problem, _ = clipping_problem(rows=3)
    enough = solve(problem, ROMP(sparsity=20, fidelity=Fidelity.LINEAR, tolerance=0.5))
    assert enough.converged.all()
    assert enough.status is Status.CONVERGED
    few = solve(problem, ROMP(sparsity=1, max_iterations=1, tolerance=1e-9))
    assert not few.converged.all()
    assert few.status is Status.ITERATION_LIMIT


def test_removed_pixels_leave_the_others_at_their_least_squares() -> None:
    problem, _ = clipping_problem(rows=8, clip_level=50.0, seed=1)
    result = solve(problem, ROMP(12, Fidelity.LINEAR))
    x, b = result.coefficients.toarray(), result.background
    signed = solve(replace(problem, nonnegative=False), ROMP(12, Fidelity.LINEAR))
    assert (signed.coefficients.data < 0).any()
    residual = problem.samples.values - predictions(problem, result.coefficients, b)
    correlations = problem.patterns.adjoint(residual)
    assert (x >= 0).all()
    np.testing.assert_allclose(correlations[x > 0], 0, atol=1e-6)


def test_chunks_change_nothing_and_report_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, _ = clipping_problem(rows=5)
    whole = solve(problem, ROMP(sparsity=3))
    calls: list[tuple[int, int]] = []
    # Chunks of two rows: 8 bytes for each of 3 n columns under K patterns.
    size = 2 * 8 * 3 * 3 * problem.patterns.count
    monkeypatch.setattr("lightmatrix.solvers.problem.CHUNK_BYTES", size)
    result = solve(
        problem, ROMP(sparsity=3), progress=lambda done, rows: calls.append((done, rows))
    )
    assert calls == [(2, 5), (4, 5), (5, 5)]
    np.testing.assert_allclose(result.coefficients.toarray(), whole.coefficients.toarray())
    np.testing.assert_array_equal(result.iterations, whole.iterations)


def test_bad_parameters() -> None:
    with pytest.raises(SolverError, match="least squares"):
        ROMP(fidelity=Fidelity.CLIPPED)
    with pytest.raises(InputError, match="at least 1"):
        ROMP(sparsity=0)
