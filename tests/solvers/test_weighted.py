"""The weighted problem: optimality by definition, and the plain problem."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.solvers import ActiveSet, Problem
from lightmatrix.solvers.active_set import Candidates, Cells, PseudoSamples, solve_weighted
from tests.helpers.problems import clipping_problem, with_samples

SOLVER = ActiveSet(tolerance=1e-8)


def every_pixel(problem: Problem, penalties: Any = 1.0) -> Candidates:
    rows, pixels = problem.rows, problem.patterns.pixels
    index = np.tile(np.arange(pixels, dtype=np.int32), rows)
    weights = np.broadcast_to(np.asarray(penalties, np.float32), (rows, pixels)).ravel()
    return Candidates(np.arange(rows + 1, dtype=np.int64) * pixels, index, weights.copy())


def objective(
    problem: Problem, x: Any, weights: Any, cells: Cells, coefficients: Any, background: Any
) -> Any:
    u = x @ problem.patterns.dense().T.astype(np.float64)
    u = u + coefficients @ cells.means + background[:, None] * problem.patterns.means
    residual = problem.samples.values - u
    residual = np.where(problem.samples.clipped, np.maximum(residual, 0), residual)
    loss = (problem.samples.weights_of_all() * residual**2).sum(axis=1) / 2
    norm = (x * weights).sum(axis=1) + coefficients @ cells.penalties
    return problem.regularization * norm + loss


def test_equal_weights_are_the_plain_problem() -> None:
    problem, _ = clipping_problem()
    solved = solve_weighted(problem, every_pixel(problem), Cells.none(problem.patterns), SOLVER)
    plain = SOLVER.solve(problem)
    assert solved.converged.all()
    np.testing.assert_allclose(solved.objective, plain.objective, rtol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_equal_nearly_equal_and_constant_columns_converge(seed: int) -> None:
    # Inner products of columns are summed in float32, which cannot tell such columns apart.
    random = np.random.default_rng(seed)
    images = random.random((24, 6, 6)).astype(np.float32)
    images[:, 1], images[:, 2] = images[:, 0], images[:, 0] * (1 - 1e-6 * random.random((24, 6)))
    images[:, 3] = 0.5
    truth = random.random((5, 36)) * (random.random((5, 36)) < 0.3)
    patterns = ImagePatterns(images)
    values = patterns.forward(truth.astype(np.float32))
    samples = Samples(values, np.zeros(values.shape, bool), np.full_like(values, np.inf), None)
    problem = Problem(patterns, samples, 1e-3)
    solved = solve_weighted(problem, every_pixel(problem), Cells.none(patterns), SOLVER)
    assert solved.converged.all()
    np.testing.assert_allclose(solved.objective, SOLVER.solve(problem).objective, rtol=1e-6)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 90),
    st.tuples(st.integers(1, 7), st.integers(2, 9)),
    st.integers(0, 3),
    st.integers(0, 2**16),
)
def test_no_change_improves_the_objective(
    count: int, shape: tuple[int, int], cells_count: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    problem, _ = clipping_problem(rows=3, shape=shape, count=count, seed=seed % 1000)
    problem = with_samples(problem, weights=random.choice([0.0, 0.5, 1.0], (3, count)))
    weights = random.uniform(0.05, 3, (3, problem.patterns.pixels))
    candidates = every_pixel(problem, weights)
    weights = candidates.data.reshape(weights.shape).astype(np.float64)
    means = random.random((cells_count, count)).astype(np.float32)
    cells = Cells(means, random.uniform(0.1, 2, cells_count).astype(np.float32))
    solved = solve_weighted(problem, candidates, cells, SOLVER)
    x = solved.coefficients.toarray()
    terms = (weights, cells)
    best = objective(problem, x, *terms, solved.cells.astype(float), solved.background)
    np.testing.assert_allclose(best, solved.objective, rtol=1e-4, atol=1e-9)
    for _ in range(20):
        step = 10.0 ** random.uniform(-4, 0)
        other = np.maximum(
            x + step * random.normal(size=x.shape) * (random.random(x.shape) < 0.2), 0
        )
        g = np.maximum(solved.cells + step * random.normal(size=solved.cells.shape), 0)
        b = np.maximum(solved.background + step * random.normal(size=3), 0)
        changed = objective(problem, other, *terms, g, b)
        assert (changed >= best * (1 - 1e-4) - 1e-9).all()


def test_only_candidates_are_used() -> None:
    problem, truth = clipping_problem(rows=4, regularization=1e-3, clip_level=1.5)
    indptr: list[int] = [0]
    pixels: list[int] = []
    for row in truth[:3]:
        pixels.extend(np.flatnonzero(row))
        indptr.append(len(pixels))
    indptr.append(len(pixels))  # The last row has no candidates.
    candidates = Candidates(
        np.array(indptr, np.int64), np.array(pixels, np.int32), np.ones(len(pixels), np.float32)
    )
    solved = solve_weighted(problem, candidates, Cells.none(problem.patterns), SOLVER)
    x = solved.coefficients.toarray()
    assert not x[truth == 0].any()
    assert not x[3].any()
    # With a known support, forty samples are enough for any row.
    error = np.linalg.norm(x[:3] - truth[:3]) / np.linalg.norm(truth[:3])
    assert error < 0.1
    assert solved.background[3] > 0


@pytest.mark.parametrize("packed", [False, True])
def test_pseudo_samples_count_as_samples(packed: bool) -> None:
    problem, truth = clipping_problem(rows=5)
    shape, count = problem.patterns.shape, problem.patterns.count
    unseen: PatternSet = BernoulliPatterns(shape, 7, seed=5)
    if not packed:
        unseen = ImagePatterns(np.random.default_rng(5).random((7, *shape)).astype(np.float32))
    random = np.random.default_rng(0)
    both = np.concatenate([problem.patterns.images(), unseen.images()])
    flat = both.reshape(count + 7, -1)
    values = (truth @ flat.T + 0.02 * random.random((5, count + 7))).astype(np.float32)
    weights = random.choice([0, 0.1, 0.5, 2], values.shape).astype(np.float32)
    weights[0] = 0
    means = np.ascontiguousarray(flat[:, :20].mean(axis=1)[None], np.float32)
    penalties = np.array([0.3], np.float32)
    solved = solve_weighted(
        problem,
        every_pixel(problem),
        Cells(means, penalties),
        SOLVER,
        pseudo_samples=PseudoSamples(unseen, values, weights),
    )
    # The same as showing the patterns twice.
    twice = np.concatenate([problem.patterns.images(), both])
    extended = Problem(
        ImagePatterns(twice),
        Samples(
            np.concatenate([problem.samples.values, values], axis=1).astype(np.float64),
            np.concatenate([problem.samples.clipped, np.zeros(values.shape, bool)], axis=1),
            np.ones(len(twice)),
            np.concatenate([np.ones(problem.samples.values.shape), weights], axis=1),
        ),
        problem.regularization,
    )
    again = np.concatenate([means[:, :count], means], axis=1)
    plain = solve_weighted(extended, every_pixel(extended), Cells(again, penalties), SOLVER)
    assert solved.converged.all()
    np.testing.assert_allclose(solved.objective, plain.objective, rtol=1e-6)


def test_a_background_of_each_row_replaces_the_means() -> None:
    problem, _ = clipping_problem(rows=4)
    random = np.random.default_rng(3)
    own = random.random(problem.samples.values.shape).astype(np.float32)
    none = Cells.none(problem.patterns)
    solved = solve_weighted(problem, every_pixel(problem), none, SOLVER, background=own)
    x, b = solved.coefficients.toarray(), solved.background
    assert solved.converged.all()
    assert (b > 0).any()

    def value(x: Any, b: Any) -> Any:
        rows = [
            objective(
                problem.take(np.array([row])),
                x[[row]],
                1.0,
                Cells(own[[row]], np.zeros(1, np.float32)),
                b[row].reshape(1, 1),
                np.zeros(1),
            )[0]
            for row in range(4)
        ]
        return np.array(rows)

    best = value(x, b)
    np.testing.assert_allclose(best, solved.objective, rtol=1e-5)
    for _ in range(20):
        step = 10.0 ** random.uniform(-4, -1)
        other = np.maximum(x + step * random.normal(size=x.shape) * (x > 0), 0)
        changed = value(other, np.maximum(b + step * random.normal(size=4), 0))
        assert (changed >= best * (1 - 1e-4) - 1e-9).all()


def test_starting_at_the_solution_leaves_only_the_certificate() -> None:
    problem, _ = clipping_problem(rows=5)
    means = problem.patterns.dense()[:, :20].mean(axis=1)[None].astype(np.float32)
    cells = Cells(means, np.array([0.2], np.float32))
    candidates = every_pixel(problem)
    first = solve_weighted(problem, candidates, cells, SOLVER)
    again = solve_weighted(problem, candidates, cells, SOLVER, start=first.rows)
    assert (again.iterations <= first.iterations).all()
    assert again.iterations.sum() < first.iterations.sum()
    np.testing.assert_allclose(again.objective, first.objective, rtol=1e-6)


def test_results_do_not_depend_on_threads() -> None:
    problem, _ = clipping_problem(rows=70)
    solved = [
        solve_weighted(
            problem,
            every_pixel(problem),
            Cells.none(problem.patterns),
            replace(SOLVER, threads=threads),
        ).coefficients
        for threads in (1, 3)
    ]
    assert (solved[0] != solved[1]).nnz == 0


def test_signed_light_and_foreign_candidates_are_refused() -> None:
    problem, _ = clipping_problem()
    none = Cells.none(problem.patterns)
    with pytest.raises(InputError, match="not negative"):
        solve_weighted(replace(problem, nonnegative=False), every_pixel(problem), none, SOLVER)
    with pytest.raises(InputError, match="candidates for 6 rows, not 2"):
        solve_weighted(problem.take(np.arange(2)), every_pixel(problem), none, SOLVER)
