"""ADMM and Saturation ADMM: their updates, their optimum, their precision."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import clipping_problem
from scipy.optimize import minimize
from scipy.sparse import csr_array

from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns import BernoulliPatterns
from lightmatrix.solvers import ADMM, Fidelity, Problem, SaturationADMM, solve
from lightmatrix.solvers.objective import objective, relative_gap
from lightmatrix.solvers.system import System

CONVEX = [Fidelity.LINEAR, Fidelity.ONE_SIDED, Fidelity.REJECTION]


def _augmented(problem: Problem) -> np.ndarray[Any, Any]:
    dense = problem.patterns.dense().astype(np.float64)
    if not problem.background:
        return dense
    scale = np.sqrt(problem.patterns.pixels)
    return np.column_stack([dense, scale * dense.mean(axis=1)])


def _brute_force(cost: Any, size: int) -> np.ndarray[Any, Any]:
    found = minimize(
        cost,
        np.zeros(size),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": 5000, "ftol": 1e-15, "gtol": 1e-10},
    )
    return found.x


@pytest.mark.parametrize("background", [False, True])
def test_admm_updates_minimise_their_own_subproblems(background: bool) -> None:
    problem, _ = clipping_problem(rows=2, shape=(4, 5), count=12, background=background)
    solver = ADMM(penalty_x=3.0)
    state = solver.init(problem)
    for _ in range(4):
        state = solver.step(problem, state)
    after = solver.step(problem, state)
    matrix, mu, lam = _augmented(problem), 3.0, problem.regularization
    for row in range(problem.rows):
        h, z, y = after.h[row], state.z[row], problem.samples[row]

        def cost(x: Any, h: Any = h, z: Any = z, y: Any = y) -> Any:
            r = matrix @ x - y
            value = r @ r / (2 * lam) + h @ (x - z) + mu / 2 * np.sum((x - z) ** 2)
            return value, matrix.T @ r / lam + h + mu * (x - z)

        np.testing.assert_allclose(after.x[row], _brute_force(cost, len(z)), atol=1e-5)
        assert after.h[row] == pytest.approx(state.h[row] + mu * (state.x[row] - state.z[row]))
        _assert_z_is_best(after.z[row], after.x[row] + h / mu, mu, background)


@pytest.mark.parametrize("background", [False, True])
@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_saturation_admm_updates_minimise_their_own_subproblems(
    fidelity: Fidelity, background: bool
) -> None:
    problem, _ = clipping_problem(rows=2, shape=(4, 5), count=12, background=background)
    solver = SaturationADMM(fidelity, penalty_x=3.0, penalty_u=0.7)
    state = solver.init(problem)
    for _ in range(4):
        state = solver.step(problem, state)
    after = solver.step(problem, state)
    matrix, mu, nu = _augmented(problem), 3.0, 0.7
    for row in range(problem.rows):
        h = state.h[row] + mu * (state.x[row] - state.z[row])
        g = state.g[row] + nu * (matrix @ state.x[row] - state.u[row])
        np.testing.assert_allclose(after.h[row], h, atol=1e-10)
        np.testing.assert_allclose(after.g[row], g, atol=1e-8)
        z, u = state.z[row], after.u[row]

        def cost(x: Any, h: Any = h, g: Any = g, z: Any = z, u: Any = u) -> Any:
            r = matrix @ x - u
            value = g @ r + nu / 2 * r @ r + h @ (x - z) + mu / 2 * np.sum((x - z) ** 2)
            return value, matrix.T @ (g + nu * r) + h + mu * (x - z)

        np.testing.assert_allclose(after.x[row], _brute_force(cost, len(z)), atol=1e-5)
        _assert_z_is_best(after.z[row], after.x[row] + h / mu, mu, background)
        # The u-update itself is held against a grid in test_prox; here: it saw the right v.
        v = matrix @ state.x[row] + g / nu
        free = ~problem.clipped[row] & (v < 0.9)
        lam_nu = problem.regularization * nu
        expected = (problem.samples[row] + lam_nu * v) / (1 + lam_nu)
        np.testing.assert_allclose(u[free], expected[free], atol=1e-9)


def _assert_z_is_best(z: Any, q: Any, mu: float, background: bool) -> None:
    grid = np.linspace(0, 10, 100_001)
    for index, (found, target) in enumerate(zip(z, q, strict=True)):
        penalised = not (background and index == len(z) - 1)
        cost = penalised * np.abs(grid) + mu / 2 * (target - grid) ** 2
        own = penalised * abs(found) + mu / 2 * (target - found) ** 2
        assert found >= 0
        assert own <= cost.min() + 1e-9


@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("background", [False, True])
def test_two_solvers_one_problem(nonnegative: bool, background: bool) -> None:
    problem, _ = clipping_problem(nonnegative=nonnegative, background=background)
    unclipped = replace(problem, clipped=np.zeros_like(problem.clipped))
    solvers = [ADMM(max_iterations=20_000, tolerance=1e-8)]
    solvers += [SaturationADMM(f, max_iterations=20_000, tolerance=1e-8) for f in CONVEX]  # type: ignore[misc]
    found = [solve(unclipped, solver) for solver in solvers]
    for solver, result in zip(solvers, found, strict=True):
        again = objective(unclipped, result.coefficients, result.background, Fidelity.LINEAR)
        np.testing.assert_allclose(again, result.objective, rtol=1e-9)
        np.testing.assert_allclose(again, found[0].objective, rtol=1e-4, err_msg=str(solver))


@pytest.mark.parametrize("fidelity", CONVEX)
@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("background", [False, True])
def test_optimum_is_certified_by_its_duality_gap(
    fidelity: Fidelity, nonnegative: bool, background: bool
) -> None:
    problem, _ = clipping_problem(nonnegative=nonnegative, background=background)
    result = solve(problem, SaturationADMM(fidelity, max_iterations=20_000, tolerance=1e-9))
    assert problem.clipped.any()
    assert (result.gap > -1e-9).all()
    assert result.gap.max() < 1e-4


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_no_point_beats_the_dual_bound(seed: int) -> None:
    """Weak duality: the gap of any point whatever is not negative."""
    problem, x = clipping_problem(seed=seed)
    random = np.random.default_rng(seed)
    anything = csr_array(np.maximum(x + 0.05 * random.standard_normal(x.shape), 0))
    for fidelity in CONVEX:
        _, gap = relative_gap(problem, anything, random.random(problem.rows), fidelity)
        assert (gap >= 0).all()


@pytest.mark.parametrize("fidelity", [Fidelity.CLIPPED, Fidelity.ONE_SIDED])
def test_clip_aware_estimates_are_far_better(fidelity: Fidelity) -> None:
    problem, x = clipping_problem(
        rows=20, shape=(16, 16), count=120, clip_level=1.5, regularization=0.02
    )
    assert 0.1 < problem.clipped.mean() < 0.6
    aware = solve(problem, SaturationADMM(fidelity)).coefficients.toarray()
    blind = solve(problem, ADMM()).coefficients.toarray()
    assert np.linalg.norm(aware - x) < 0.25 * np.linalg.norm(blind - x)


@pytest.mark.parametrize(("size", "count"), [((32, 32), 128), ((64, 64), 256)])
def test_single_and_double_precision_agree(size: tuple[int, int], count: int) -> None:
    double, _ = clipping_problem(rows=4, shape=size, count=count, regularization=0.1)
    single = replace(
        double,
        samples=double.samples.astype(np.float32),
        clip_level=double.clip_level.astype(np.float32),
    )
    for solver in (ADMM(), SaturationADMM(), SaturationADMM(Fidelity.CLIPPED)):
        one, two = solve(single, solver), solve(double, solver)
        assert one.coefficients.dtype == np.float32
        np.testing.assert_allclose(one.objective, two.objective, rtol=2e-3)
        difference = one.coefficients.toarray() - two.coefficients.toarray()
        assert np.linalg.norm(difference) < 0.01 * np.linalg.norm(two.coefficients.toarray())


def test_single_precision_is_safe_at_full_size() -> None:
    """N = 16,384 and K = 1,024: the factor is double, the rows are single."""
    patterns = BernoulliPatterns((128, 128), 1024, seed=3)
    random = np.random.default_rng(0)
    system = System(patterns, 0.03, background=True)
    target = random.standard_normal((2, 1024))
    point = random.standard_normal((2, system.unknowns))
    exact, prediction = system.solve(target, point)
    single, _ = system.solve(target.astype(np.float32), point.astype(np.float32))
    assert np.linalg.norm(single - exact) < 1e-4 * np.linalg.norm(exact)
    gradient = system.adjoint(system.forward(exact) - target) + 0.03 * (exact - point)
    assert np.linalg.norm(gradient) < 1e-7 * np.linalg.norm(system.adjoint(target))
    np.testing.assert_allclose(prediction, system.forward(exact), atol=1e-7)


def test_system_solves_wide_and_tall_problems_alike() -> None:
    random = np.random.default_rng(1)
    for shape, count in (((3, 4), 40), ((7, 8), 20)):
        for background in (False, True):
            scale = random.random(count) + 0.5
            system = System(BernoulliPatterns(shape, count), 0.3, background, scale)
            target = random.standard_normal((5, count))
            point = random.standard_normal((5, system.unknowns))
            x, prediction = system.solve(target, point)
            np.testing.assert_allclose(prediction, system.forward(x), atol=1e-9)
            gradient = system.adjoint(prediction - target) + 0.3 * (x - point)
            np.testing.assert_allclose(gradient, 0, atol=1e-8)


def test_rows_stop_by_themselves() -> None:
    """A row's answer depends on no other row of its batch."""
    problem, _ = clipping_problem(rows=12)
    solver = SaturationADMM(tolerance=1e-3)
    together = solve(problem, solver)
    assert len(np.unique(together.iterations)) > 3
    for row in range(problem.rows):
        alone = solve(problem.take(np.array([row])), solver)
        assert alone.iterations[0] == together.iterations[row]
        np.testing.assert_allclose(
            alone.coefficients.toarray()[0], together.coefficients[[row]].toarray()[0], atol=1e-9
        )


def test_weights_mask_and_scale() -> None:
    problem, _ = clipping_problem()
    weights = np.ones(problem.samples.shape)
    weights[:, :10] = 0
    masked = replace(problem, weights=weights)
    spoiled = problem.samples.copy()
    spoiled[:, :10] = 77.0
    exact = SaturationADMM(max_iterations=20_000, tolerance=1e-8)
    one = solve(masked, exact)
    two = solve(replace(masked, samples=spoiled, clipped=problem.clipped), exact)
    np.testing.assert_allclose(one.objective, two.objective, rtol=1e-6)
    # Four times the weight and four times the regularization is the same problem.
    strong = replace(problem, weights=np.full(problem.patterns.count, 4.0), regularization=0.2)
    linear = ADMM(max_iterations=20_000, tolerance=1e-8)
    np.testing.assert_allclose(
        solve(strong, linear).objective, 4 * solve(problem, linear).objective, rtol=1e-4
    )


def test_admm_refuses_weights_that_differ_between_rows() -> None:
    problem, _ = clipping_problem()
    weights = np.ones(problem.samples.shape)
    weights[0, 0] = 0
    with pytest.raises(SolverError, match="Saturation ADMM"):
        solve(replace(problem, weights=weights), ADMM())


@pytest.mark.parametrize("bad", [{"penalty_x": -1.0}, {"penalty_x": np.nan}, {"tolerance": 0.0}])
def test_parameters_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match="positive"):
        ADMM(**bad)  # type: ignore[arg-type]


def test_dark_rows_and_no_rows() -> None:
    problem, _ = clipping_problem()
    dark = replace(
        problem,
        samples=np.zeros_like(problem.samples),
        clipped=np.zeros_like(problem.clipped),
    )
    for solver in (ADMM(), SaturationADMM()):
        result = solve(dark, solver)
        assert result.converged.all()
        assert result.coefficients.nnz == 0
        assert np.isfinite(result.gap).all()
        nothing = solve(problem.take(np.arange(0)), solver)
        assert nothing.coefficients.shape == (0, problem.patterns.pixels)
