"""ADMM and Saturation ADMM: their updates, their optimum, their precision."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.solvers import ADMM, ActiveSet, Fidelity, Problem, SaturationADMM, solve
from lightmatrix.solvers.admm import System
from lightmatrix.solvers.problem import objective
from tests.helpers.problems import clipping_problem, with_samples

CONVEX = [Fidelity.LINEAR, Fidelity.ONE_SIDED, Fidelity.REJECTION]
# Projector size for rows that are solved to the last digit. That takes 1,800 iterations here, but
# up to 13,000 at 9 x 11.
QUICK: dict[str, Any] = {"rows": 2, "shape": (6, 7), "count": 24}


def _augmented(problem: Problem, scale: float) -> np.ndarray[Any, Any]:
    """Columns of the unknowns: pixels x and, with a background, c / scale = (sum x + b) / scale."""
    dense = problem.patterns.dense().astype(np.float64)
    if not problem.background:
        return dense
    means = dense.mean(axis=1, keepdims=True)
    return np.column_stack([dense - means, scale * means])


def _brute_force(cost: Any, size: int) -> np.ndarray[Any, Any]:
    optimum = minimize(
        cost,
        np.zeros(size),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": 5000, "ftol": 1e-15, "gtol": 1e-10},
    )
    return optimum.x


@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("background", [False, True])
def test_admm_updates_minimise_their_own_subproblems(background: bool, nonnegative: bool) -> None:
    problem, _ = clipping_problem(
        rows=2, shape=(4, 5), count=12, background=background, nonnegative=nonnegative
    )
    solver = ADMM(penalty_x=3.0)
    state = solver.init(problem)
    for _ in range(4):
        state = solver.step(problem, state)
    after = solver.step(problem, state)
    scale = state.system.scale
    matrix, mu, lam = _augmented(problem, scale), 3.0, problem.regularization
    for row in range(problem.rows):
        h, z, y = after.h[row], state.z[row], problem.samples.values[row]

        def cost(x: Any, h: Any = h, z: Any = z, y: Any = y) -> Any:
            r = matrix @ x - y
            value = r @ r / (2 * lam) + h @ (x - z) + mu / 2 * np.sum((x - z) ** 2)
            return value, matrix.T @ r / lam + h + mu * (x - z)

        np.testing.assert_allclose(after.x[row], _brute_force(cost, len(z)), atol=1e-5)
        assert after.h[row] == pytest.approx(state.h[row] + mu * (state.x[row] - state.z[row]))
        _assert_z_is_best(after.z[row], after.x[row] + h / mu, mu, problem, scale)


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
    scale = state.system.scale
    matrix, mu, nu = _augmented(problem, scale), 3.0, 0.7
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
        _assert_z_is_best(after.z[row], after.x[row] + h / mu, mu, problem, scale)
        # test_fidelity checks the u-update itself; this checks that it gets the right v.
        v = matrix @ state.x[row] + g / nu
        free = ~problem.samples.clipped[row] & (v < 0.9)
        lam_nu = problem.regularization * nu
        expected = (problem.samples.values[row] + lam_nu * v) / (1 + lam_nu)
        np.testing.assert_allclose(u[free], expected[free], atol=1e-9)


def _assert_z_is_best(z: Any, q: Any, mu: float, problem: Problem, scale: float) -> None:
    """Assert that z minimises its subproblem, by brute force over z = positive - negative and c."""
    pixels, signed = problem.patterns.pixels, not problem.nonnegative
    extra = len(z) - pixels

    def cost(v: Any) -> Any:
        parts, c = v[: 2 * pixels], v[2 * pixels :]
        z = np.concatenate([parts[:pixels] - parts[pixels:], c])
        slope = mu * (z - q)
        gradient = [1 + slope[:pixels], 1 - slope[:pixels], slope[pixels:]]
        return parts.sum() + mu / 2 * np.sum((z - q) ** 2), np.concatenate(gradient)

    bounds = [(0, None)] * pixels + [(0, None if signed else 0)] * pixels + [(None, None)] * extra
    room = np.concatenate([-np.ones(pixels), np.zeros(pixels), np.full(extra, scale)])
    capped = [{"type": "ineq", "fun": lambda v: room @ v, "jac": lambda _: room}]
    optimum = minimize(
        cost,
        np.zeros(len(room)),
        jac=True,
        method="SLSQP",
        bounds=bounds,
        constraints=capped if extra and not signed else [],
        options={"maxiter": 1000, "ftol": 1e-15},
    )
    x = optimum.x
    best = np.concatenate([x[:pixels] - x[pixels : 2 * pixels], x[2 * pixels :]])
    np.testing.assert_allclose(z, best, atol=1e-5)


@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("background", [False, True])
def test_two_solvers_one_problem(nonnegative: bool, background: bool) -> None:
    problem, _ = clipping_problem(nonnegative=nonnegative, background=background, **QUICK)
    unclipped = with_samples(problem, clipped=np.zeros_like(problem.samples.clipped))
    solvers = [ADMM(max_iterations=20_000, tolerance=1e-8)]
    solvers += [SaturationADMM(f, max_iterations=20_000, tolerance=1e-8) for f in CONVEX]  # type: ignore[misc]
    results = [solve(unclipped, solver) for solver in solvers]
    for solver, result in zip(solvers, results, strict=True):
        again = objective(unclipped, result.coefficients, result.background, Fidelity.LINEAR)
        np.testing.assert_allclose(again, result.objective, rtol=1e-9)
        np.testing.assert_allclose(again, results[0].objective, rtol=1e-9, err_msg=str(solver))


@pytest.mark.parametrize("fidelity", CONVEX)
@pytest.mark.parametrize("nonnegative", [False, True])
@pytest.mark.parametrize("background", [False, True])
def test_the_active_set_finds_the_same_optimum(
    fidelity: Fidelity, nonnegative: bool, background: bool
) -> None:
    problem, _ = clipping_problem(nonnegative=nonnegative, background=background, **QUICK)
    result = solve(problem, SaturationADMM(fidelity, max_iterations=20_000, tolerance=1e-9))
    assert problem.samples.clipped.any()
    certified = solve(problem, ActiveSet(fidelity, tolerance=1e-8))
    np.testing.assert_allclose(result.objective, certified.objective, rtol=1e-5)


@pytest.mark.parametrize("fidelity", [Fidelity.CLIPPED, Fidelity.ONE_SIDED])
def test_clip_aware_estimates_are_far_better(fidelity: Fidelity) -> None:
    problem, x = clipping_problem(
        rows=20, shape=(16, 16), count=120, clip_level=1.5, regularization=0.02
    )
    assert 0.1 < problem.samples.clipped.mean() < 0.6
    aware = solve(problem, SaturationADMM(fidelity)).coefficients.toarray()
    blind = solve(problem, ADMM()).coefficients.toarray()
    assert np.linalg.norm(aware - x) < 0.25 * np.linalg.norm(blind - x)


@pytest.mark.parametrize(
    ("size", "count"), [((32, 32), 128), pytest.param((64, 64), 256, marks=pytest.mark.slow)]
)
def test_single_and_double_precision_agree(size: tuple[int, int], count: int) -> None:
    double, _ = clipping_problem(rows=4, shape=size, count=count, regularization=0.1)
    single = with_samples(
        double,
        values=double.samples.values.astype(np.float32),
        clip_level=double.samples.clip_level.astype(np.float32),
    )
    for solver in (ADMM(), SaturationADMM(), SaturationADMM(Fidelity.CLIPPED)):
        one, two = solve(single, solver), solve(double, solver)
        assert one.coefficients.dtype == np.float32
        np.testing.assert_allclose(one.objective, two.objective, rtol=2e-3)
        difference = one.coefficients.toarray() - two.coefficients.toarray()
        assert np.linalg.norm(difference) < 0.01 * np.linalg.norm(two.coefficients.toarray())


def test_system_solves_wide_and_tall_problems_alike() -> None:
    random = np.random.default_rng(1)
    for shape, count in (((3, 4), 40), ((7, 8), 20)):
        for background in (False, True):
            scale = random.random(count) + 0.5
            patterns = BernoulliPatterns(shape, count)
            column = patterns.means if background else None
            system = System(patterns, 0.3, column, scale)
            target = random.standard_normal((5, count))
            point = random.standard_normal((5, system.unknowns))
            x, prediction = system.solve(target, point)
            np.testing.assert_allclose(prediction, system.forward(x), atol=1e-9)
            gradient = system.adjoint(prediction - target) + 0.3 * (x - point)
            np.testing.assert_allclose(gradient, 0, atol=1e-8)
            one, other = system.forward(point), system.adjoint(target)
            np.testing.assert_allclose((one * target).sum(), (point * other).sum())


def test_background_is_the_light_that_pixels_do_not_explain() -> None:
    """The system's unknowns predict P x + b m, with m the patterns' means."""
    random = np.random.default_rng(2)
    patterns = BernoulliPatterns((5, 6), 12)
    system = System(patterns, 1.0, patterns.means)
    unknowns = random.random((3, system.unknowns))
    x, b = system.split(unknowns)
    expected = patterns.forward(np.ascontiguousarray(x)) + np.outer(b, patterns.means)
    np.testing.assert_allclose(system.forward(unknowns), expected)


def test_bound_of_the_background_does_not_stall() -> None:
    """Rows whose background the bound holds at 0 converge as fast as others.

    Plain ADMM meets such rows wherever much clips; a bound on b alone stalls it for thousands of
    iterations, because the uniform part of x moves by 1 / N a step.
    """
    problem, _ = clipping_problem(rows=8, shape=(48, 48), count=150, regularization=0.2)
    blind = solve(problem, ADMM(tolerance=1e-4))
    assert (blind.background == 0).any()
    assert blind.converged.all()
    assert blind.iterations.max() < 600
    certified = solve(problem, ActiveSet(Fidelity.LINEAR, tolerance=1e-8))
    assert (blind.objective < 1.05 * certified.objective).all()


def test_rows_stop_by_themselves() -> None:
    """A row's solution does not depend on the other rows of its batch."""
    problem, _ = clipping_problem(rows=12)
    solver = SaturationADMM(tolerance=1e-4)
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
    weights = np.ones(problem.samples.values.shape)
    weights[:, :10] = 0
    masked = with_samples(problem, weights=weights)
    spoiled = problem.samples.values.copy()
    spoiled[:, :10] = 77.0
    exact = SaturationADMM(max_iterations=20_000, tolerance=1e-8)
    one = solve(masked, exact)
    two = solve(with_samples(masked, values=spoiled, clipped=problem.samples.clipped), exact)
    np.testing.assert_allclose(one.objective, two.objective, rtol=1e-6)
    # Four times the weight with four times the regularization is the same problem.
    strong = replace(
        with_samples(problem, weights=np.full(problem.patterns.count, 4.0)), regularization=0.2
    )
    linear = ADMM(max_iterations=20_000, tolerance=1e-8)
    np.testing.assert_allclose(
        solve(strong, linear).objective, 4 * solve(problem, linear).objective, rtol=1e-4
    )


def test_admm_refuses_weights_that_differ_between_rows() -> None:
    problem, _ = clipping_problem()
    weights = np.ones(problem.samples.values.shape)
    weights[0, 0] = 0
    with pytest.raises(SolverError, match="Saturation ADMM"):
        solve(with_samples(problem, weights=weights), ADMM())


@pytest.mark.parametrize("bad", [{"penalty_x": -1.0}, {"penalty_x": np.nan}, {"tolerance": 0.0}])
def test_parameters_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match="positive"):
        ADMM(**bad)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="at least 1"):
        SaturationADMM(max_iterations=0)


def test_dark_rows_and_no_rows() -> None:
    problem, _ = clipping_problem()
    dark = with_samples(
        problem,
        values=np.zeros_like(problem.samples.values),
        clipped=np.zeros_like(problem.samples.clipped),
    )
    for solver in (ADMM(), SaturationADMM()):
        result = solve(dark, solver)
        assert result.converged.all()
        assert result.coefficients.nnz == 0
        nothing = solve(problem.take(np.arange(0)), solver)
        assert nothing.coefficients.shape == (0, problem.patterns.pixels)
