"""The loop of all iterative solvers: limits, status, progress, memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from lightmatrix.solvers import ADMM, ROMP, Fidelity, Problem, Result, SaturationADMM, Status, solve
from lightmatrix.solvers.problem import objective
from tests.helpers.problems import clipping_problem, with_samples


def test_rows_of_the_result_are_rows_of_the_problem() -> None:
    """Rows stop in any order, but results keep the order of the problem."""
    problem, _ = clipping_problem(rows=30)
    result = solve(problem, SaturationADMM())
    assert (np.diff(result.iterations) < 0).any()
    order = np.random.default_rng(0).permutation(30)
    shuffled = solve(problem.take(order), SaturationADMM())
    np.testing.assert_array_equal(shuffled.iterations, result.iterations[order])
    np.testing.assert_allclose(
        shuffled.coefficients.toarray(), result.coefficients.toarray()[order], atol=1e-9
    )
    np.testing.assert_allclose(shuffled.background, result.background[order], atol=1e-9)


def test_progress_counts_finished_rows() -> None:
    problem, _ = clipping_problem(rows=15)
    seen: list[tuple[int, int]] = []
    result = solve(problem, ADMM(), progress=lambda done, total: seen.append((done, total)))
    assert result.status is Status.CONVERGED
    assert result.converged.all()
    assert seen[-1] == (15, 15)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})


def test_the_iteration_limit_is_reported_and_rows_are_kept() -> None:
    problem, _ = clipping_problem(rows=12)
    steps = int(np.median(solve(problem, SaturationADMM()).iterations))
    result = solve(problem, SaturationADMM(max_iterations=steps))
    assert result.status is Status.ITERATION_LIMIT
    assert 0 < result.converged.sum() < 12
    assert result.iterations.max() == steps
    assert (result.iterations[~result.converged] == steps).all()
    again = objective(problem, result.coefficients, result.background, Fidelity.ONE_SIDED)
    np.testing.assert_allclose(result.objective, again, rtol=1e-12)


@dataclass(frozen=True)
class _Breaking(SaturationADMM):
    """The row with the brightest samples becomes infinite at the third step."""

    def step(self, problem: Problem, state: Any) -> Any:
        after = super().step(problem, state)
        broken = after.x.copy()
        if np.abs(state.h).max() > 0:
            broken[problem.samples.values.max(axis=1) > 90] = np.nan
        return replace(after, x=broken)


def test_a_row_that_is_not_finite_stops_alone() -> None:
    problem, _ = clipping_problem(rows=6)
    samples, clipped = problem.samples.values.copy(), problem.samples.clipped.copy()
    samples[2], clipped[2] = 99.0, False
    spoiled = with_samples(problem, values=samples, clipped=clipped)
    others = np.delete(np.arange(6), 2)
    result = solve(spoiled, _Breaking())
    assert result.status is Status.NOT_FINITE
    assert result.iterations[2] < 5
    assert not result.converged[2]
    assert result.converged[others].all()
    assert np.isfinite(result.coefficients.data).all()
    expected = solve(problem, SaturationADMM())
    np.testing.assert_allclose(
        result.coefficients.toarray()[others], expected.coefficients.toarray()[others], atol=1e-9
    )


def test_a_solver_may_have_its_own_loop() -> None:
    problem, _ = clipping_problem()
    expected = ROMP().solve(problem)

    @dataclass(frozen=True)
    class Own:
        def solve(self, problem: Problem, progress: Any = None) -> Result:
            progress(1, 2)
            return expected

        def row_bytes(self, patterns: int, pixels: int) -> int:
            return 1

    seen: list[tuple[int, int]] = []
    assert solve(problem, Own(), progress=lambda *now: seen.append(now)) is expected
    assert seen == [(1, 2)]


@pytest.mark.parametrize("solver", [ADMM(), SaturationADMM(), ROMP()])
def test_rows_take_no_more_memory_than_the_solver_says(solver: Any) -> None:
    """Compares many rows with few, so that shared memory does not count."""
    peaks = {}
    for rows in (40, 400):
        problem, _ = clipping_problem(rows=rows, shape=(64, 64), count=96, dtype=np.float32)
        solve(problem.take(np.arange(10)), replace(solver, max_iterations=2))
        tracemalloc.start()
        solve(problem, replace(solver, max_iterations=4))
        peaks[rows] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    measured = (peaks[400] - peaks[40]) / 360
    promised = solver.row_bytes(96, 64 * 64)
    assert measured <= promised
    assert measured > promised / 3
