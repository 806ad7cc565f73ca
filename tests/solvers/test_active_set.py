"""The active-set solver against its definition and against an independent solver."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.solvers import ActiveSet, Fidelity, Problem, Result, active_set, solve
from tests.helpers.problems import with_samples

CONVEX = [Fidelity.ONE_SIDED, Fidelity.REJECTION, Fidelity.LINEAR]


def draw(
    patterns: PatternSet,
    rows: int,
    seed: int = 0,
    *,
    level: float = 0.8,
    regularization: float = 0.1,
    weighted: bool = False,
    nonnegative: bool = True,
    background: bool = True,
) -> Problem:
    """Rows of a few responses each, with noise, clipped at slightly different levels."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((rows, patterns.pixels))
    for row in truth:
        row[rng.integers(0, patterns.pixels, 3)] = rng.random(3)
    u = patterns.forward(truth) + 0.3 * rng.random((rows, 1)) * patterns.means
    y = u + rng.normal(0, 0.003, u.shape)
    levels = level * rng.uniform(0.9, 1.1, u.shape)
    clipped = y >= levels
    weights = rng.random(u.shape) * (rng.random(u.shape) < 0.9) if weighted else None
    return Problem(
        patterns,
        Samples(np.minimum(y, levels), clipped, levels, weights),
        regularization,
        nonnegative=nonnegative,
        background=background,
    )


def dense_gap(problem: Problem, result: Result, fidelity: Fidelity) -> NDArray[np.float64]:
    """Objective and gap by definition, row by row, without code of the package."""
    p = problem.patterns.dense().astype(np.float64)
    m = p.mean(axis=1)
    lam = problem.regularization
    gaps = np.empty(problem.rows)
    for i, (y, clipped) in enumerate(
        zip(problem.samples.values, problem.samples.clipped, strict=True)
    ):
        w = problem.samples.weights_of_all()[i].astype(np.float64)
        if fidelity is Fidelity.REJECTION:
            w = np.where(clipped, 0, w)
        one_sided = clipped & (fidelity is Fidelity.ONE_SIDED)
        x = result.coefficients[[i]].toarray()[0]
        r = y - p @ x - result.background[i] * m
        r = np.where(one_sided, np.maximum(r, 0), r)
        primal = lam * np.abs(x).sum() + (w * r**2).sum() / 2
        assert primal == pytest.approx(result.objective[i], rel=1e-9, abs=1e-12)
        if problem.nonnegative:
            assert x.min() >= 0
            assert result.background[i] >= 0
        if not problem.background:
            assert result.background[i] == 0
        theta = w * r
        if problem.background:
            # Make the point feasible: subtract its part along m on the two-sided samples.
            excess = theta @ m
            excess = max(excess, 0) if problem.nonnegative else excess
            free = (w > 0) & ~one_sided
            energy = (m[free] ** 2).sum()
            if energy > 0:
                theta = theta - np.where(free, excess / energy * m, 0)
            elif abs(excess) > 0:
                theta = np.where(m > 0, 0, theta)
        correlations = p.T @ theta
        most = correlations.max() if problem.nonnegative else np.abs(correlations).max()
        linear = y @ theta
        quadratic = (theta[w > 0] ** 2 / w[w > 0]).sum()
        best = linear / quadratic if quadratic > 0 else 0.0
        scale = min(max(best, 0), lam / most if most > 0 else np.inf, 2)
        dual = scale * linear - scale**2 * quadratic / 2
        gaps[i] = (primal - dual) / max(primal, 1e-6 * (y**2).sum() / 2, 1e-300)
    return gaps


def reference(problem: Problem, row: int, fidelity: Fidelity) -> float:
    """The optimal objective of one row, by SciPy's bound-constrained quasi-Newton method."""
    p = problem.patterns.dense().astype(np.float64)
    y, clipped = problem.samples.values[row], problem.samples.clipped[row]
    w = problem.samples.weights_of_all()[row].astype(np.float64)
    if fidelity is Fidelity.REJECTION:
        w = np.where(clipped, 0, w)
    one_sided = clipped & (fidelity is Fidelity.ONE_SIDED)
    lam, n = problem.regularization, p.shape[1]
    columns = [p, p.mean(axis=1)[:, None]] if problem.background else [p]
    price = np.zeros(n + problem.background)
    price[:n] = lam
    if not problem.nonnegative:
        columns = [np.hstack(columns), -np.hstack(columns)]
        price = np.concatenate([price, price])
    matrix = np.hstack(columns)

    def value(v: NDArray[Any]) -> tuple[float, NDArray[Any]]:
        r = y - matrix @ v
        r = np.where(one_sided, np.maximum(r, 0), r)
        return price @ v + (w * r**2).sum() / 2, price - matrix.T @ (w * r)

    v = np.zeros(matrix.shape[1])
    limits = {"maxiter": 20_000, "maxfun": 40_000, "ftol": 1e-16, "gtol": 1e-11, "maxcor": 50}
    for _ in range(3):  # restarts clear the curvature memory
        v = minimize(
            value, v, jac=True, method="L-BFGS-B", bounds=[(0, None)] * len(v), options=limits
        ).x
    return value(v)[0]


def sets() -> list[PatternSet]:
    rng = np.random.default_rng(5)
    return [
        BernoulliPatterns((9, 7), 40, seed=2),
        BernoulliPatterns((5, 5), 1),
        BernoulliPatterns((11, 13), 70, density=0.2),
        HadamardPatterns((8, 8), 40, order="random", permute=True),
        HadamardPatterns((7, 5), 30, order="sequency"),
        ImagePatterns(rng.random((30, 6, 7)).astype(np.float32)),
        BlockPatterns((6, 8), (2, 3)),
        # Two equal patterns, a white and a black one.
        ImagePatterns(
            np.stack([*([rng.random((5, 6)) < 0.5] * 2), np.ones((5, 6)), np.zeros((5, 6))]).astype(
                np.float32
            )
        ),
    ]


@pytest.mark.parametrize("fidelity", CONVEX)
@pytest.mark.parametrize("patterns", sets(), ids=lambda p: f"{type(p).__name__}-{p.count}")
@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("background", [True, False])
def test_every_row_is_certified(
    patterns: PatternSet, fidelity: Fidelity, nonnegative: bool, background: bool
) -> None:
    for weighted in (False, True):
        problem = draw(
            patterns, 12, weighted=weighted, nonnegative=nonnegative, background=background
        )
        result = solve(problem, ActiveSet(fidelity))
        assert result.converged.all()
        assert result.gap.max() <= 1e-4
        gaps = dense_gap(problem, result, fidelity)
        # The certified gap belongs to the final point, and no objective is below the optimum.
        np.testing.assert_allclose(gaps, result.gap, atol=1e-7)
        assert gaps.min() >= -1e-9


@pytest.mark.parametrize("fidelity", CONVEX)
@pytest.mark.parametrize("nonnegative", [True, False])
def test_objective_agrees_with_an_independent_solver(fidelity: Fidelity, nonnegative: bool) -> None:
    for patterns in (sets()[0], sets()[5]):
        problem = draw(patterns, 4, seed=7, nonnegative=nonnegative, weighted=nonnegative)
        rough = solve(problem, ActiveSet(fidelity))
        fine = solve(problem, ActiveSet(fidelity, tolerance=1e-6))
        for row in range(problem.rows):
            best = reference(problem, row, fidelity)
            floor = max(rough.objective[row], 1e-6 * (problem.samples.values[row] ** 2).sum() / 2)
            assert rough.objective[row] - best <= (rough.gap[row] + 1e-7) * floor
            assert abs(fine.objective[row] - best) <= 1e-6 * floor


@given(
    rows=st.integers(0, 5),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    count=st.integers(1, 70),
    level=st.sampled_from([0.02, 0.5, 100.0]),
    regularization=st.sampled_from([1e-3, 0.1, 50.0]),
    seed=st.integers(0, 99),
    fidelity=st.sampled_from(CONVEX),
)
@settings(max_examples=60, deadline=None)
def test_any_size_and_any_clipping(
    rows: int,
    shape: tuple[int, int],
    count: int,
    level: float,
    regularization: float,
    seed: int,
    fidelity: Fidelity,
) -> None:
    patterns = BernoulliPatterns(shape, count, seed=seed)
    problem = draw(patterns, rows, seed, level=level, regularization=regularization)
    result = solve(problem, ActiveSet(fidelity))
    assert result.coefficients.shape == (rows, patterns.pixels)
    assert result.converged.all()
    if rows:
        assert dense_gap(problem, result, fidelity).max() <= 1.01e-4


def degenerate(kind: str, shape: tuple[int, int], count: int, seed: int) -> PatternSet:
    """Patterns with dependent columns, as images of zeros and ones or of any values."""
    rng = np.random.default_rng(seed)
    images = (rng.random((count, *shape)) < 0.5).astype(np.float32)
    if kind == "duplicates":
        images[rng.integers(count, size=count // 2)] = images[0]
        images[:, :, : shape[1] // 2] = images[:, :, :1]
    elif kind == "constant":
        images = np.broadcast_to(rng.random((count, 1, 1), np.float32), images.shape).copy()
    elif kind == "black and white":
        images[0], images[-1] = 0, 1
    return ImagePatterns(images)


@given(
    kind=st.sampled_from(["duplicates", "constant", "black and white"]),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    count=st.sampled_from([1, 2, 3, 17, 65]),
    level=st.sampled_from([0.02, 0.2, 100.0]),
    regularization=st.sampled_from([1e-3, 0.03, 1.0]),
    seed=st.integers(0, 999),
    all_clipped=st.booleans(),
    nonnegative=st.booleans(),
    background=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_patterns_with_dependent_columns(
    kind: str,
    shape: tuple[int, int],
    count: int,
    level: float,
    regularization: float,
    seed: int,
    all_clipped: bool,
    nonnegative: bool,
    background: bool,
) -> None:
    problem = draw(
        degenerate(kind, shape, count, seed),
        4,
        seed,
        level=level,
        regularization=regularization,
        nonnegative=nonnegative,
        background=background,
    )
    if all_clipped:
        problem = with_samples(problem, clipped=np.ones_like(problem.samples.clipped))
    result = solve(problem, ActiveSet())
    assert result.converged.all()
    assert dense_gap(problem, result, Fidelity.ONE_SIDED).max() <= 1.01e-4


def test_dark_and_fully_clipped_rows() -> None:
    patterns = BernoulliPatterns((16, 16), 48)
    samples = np.zeros((3, 48), np.float32)
    samples[1] = 1
    samples[2] = patterns.means
    clipped = np.zeros((3, 48), bool)
    clipped[1] = True
    problem = Problem(patterns, Samples(samples, clipped, np.ones(48, np.float32)), 0.3)
    result = solve(problem, ActiveSet())
    assert result.converged.all()
    assert result.coefficients.nnz == 0
    assert result.background[0] == 0
    # With all samples clipped, a b that reaches the level everywhere costs nothing.
    assert (result.background[1] * patterns.means >= 1 - 1e-6).all()
    assert result.background[2] == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize(
    ("shape", "count", "rows", "tile"),
    # The second patterns exceed the caches, so that many rows share a pass.
    [((20, 30), 64, 300, 47), pytest.param((512, 520), 400, 40, 9, marks=pytest.mark.slow)],
)
def test_results_do_not_depend_on_threads_or_tiles(
    shape: tuple[int, int], count: int, rows: int, tile: int
) -> None:
    problem = draw(BernoulliPatterns(shape, count), rows, regularization=0.03)
    whole = solve(problem, ActiveSet(threads=1))
    many = solve(problem, ActiveSet(threads=3))
    parts = [
        solve(problem.take(np.arange(start, min(start + tile, rows))), ActiveSet())
        for start in range(0, rows, tile)
    ]
    assert whole.converged.all()
    for name in ("background", "objective", "gap", "iterations"):
        expected = getattr(whole, name)
        np.testing.assert_array_equal(getattr(many, name), expected)
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), expected)
    for name in ("data", "indices"):
        expected = getattr(whole.coefficients, name)
        np.testing.assert_array_equal(getattr(many.coefficients, name), expected)
        pieces = np.concatenate([getattr(p.coefficients, name) for p in parts])
        np.testing.assert_array_equal(pieces, expected)


@pytest.mark.parametrize("name", ["avx2", "avx512", "amx"])
def test_every_instruction_set_gives_the_same_solution(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    patterns = BernoulliPatterns((20, 31), 80)
    problem = draw(patterns, 40, regularization=0.03)
    solutions = []
    for instructions in ("portable", name):
        try:
            core = patterns.prepare(instructions=instructions)
        except ValueError as error:
            pytest.skip(f"nothing to compare the portable code with: {error}")
        monkeypatch.setattr(active_set, "prepared", lambda _, core=core: core)
        solutions.append(solve(problem, ActiveSet()))
    portable, other = solutions
    np.testing.assert_array_equal(other.coefficients.indices, portable.coefficients.indices)
    # Sweeps run in float32, so rounding changes where they end.
    np.testing.assert_allclose(
        other.coefficients.data, portable.coefficients.data, rtol=1e-9, atol=1e-10
    )
    np.testing.assert_allclose(other.gap, portable.gap, atol=1e-9)


def test_hadamard_by_transform_agrees_with_the_same_patterns_as_images() -> None:
    fast = HadamardPatterns((13, 11), 60, order="random", permute=True)
    plain = ImagePatterns(fast.images())
    problem = draw(fast, 10)
    a = solve(problem, ActiveSet(tolerance=1e-7))
    b = solve(replace(problem, patterns=plain), ActiveSet(tolerance=1e-7))
    np.testing.assert_allclose(a.objective, b.objective, rtol=2e-7)


def test_rows_stop_at_the_limit_of_passes() -> None:
    problem = draw(BernoulliPatterns((20, 20), 90), 30, regularization=0.005)
    result = solve(problem, ActiveSet(max_passes=1, tolerance=1e-8))
    assert not result.converged.all()
    assert "raise the limit" in result.status
    # The gap bounds how far the objective lies above the least one, and is no worse than that of
    # the dual point from the row's own residual.
    least = solve(problem, ActiveSet(tolerance=1e-8)).objective
    assert (result.objective * (1 - result.gap) <= least * (1 + 1e-6)).all()
    assert (least <= result.objective * (1 + 1e-6)).all()
    assert (result.gap <= dense_gap(problem, result, Fidelity.ONE_SIDED) + 1e-7).all()


def test_progress_reaches_the_end() -> None:
    problem = draw(BernoulliPatterns((20, 20), 50), 20)
    calls: list[tuple[int, int]] = []
    solve(problem, ActiveSet(), progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (20, 20)


def test_unsupported_settings_are_refused() -> None:
    with pytest.raises(SolverError, match="not convex"):
        ActiveSet(Fidelity.CLIPPED)
    for wrong in ({"tolerance": 0.0}, {"max_passes": 0}, {"threads": 0}):
        with pytest.raises(InputError):
            ActiveSet(**wrong)


def test_an_error_in_progress_stops_the_solver() -> None:
    problem = draw(BernoulliPatterns((20, 20), 50), 20)

    def fail(done: int, total: int) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        solve(problem, ActiveSet(), progress=fail)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of another kind")
def test_ctrl_c_stops_a_solve() -> None:
    # A problem that takes minutes: noise with a tiny regularization.
    script = (
        # Shells start background jobs with interrupts ignored, which this child would inherit.
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import numpy as np\n"
        "from lightmatrix.capture.samples import Samples\n"
        "from lightmatrix.patterns.bits import BernoulliPatterns\n"
        "from lightmatrix.solvers import ActiveSet, Problem, solve\n"
        "p = BernoulliPatterns((64, 64), 512)\n"
        "y = np.random.default_rng(0).random((20000, 512))\n"
        "c = np.zeros(y.shape, bool)\n"
        "problem = Problem(p, Samples(y, c, np.ones(512)), 0.01)\n"
        "print('ready', flush=True)\n"
        "solve(problem, ActiveSet(tolerance=1e-9))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(1.0)
        assert process.poll() is None
        others = os.times().children_user
        before = psutil.Process(process.pid).cpu_times().user
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert "KeyboardInterrupt" in errors
    # Seconds of the processor, as by the clock a busy machine takes long. The solve takes minutes.
    assert os.times().children_user - others - before < 5
