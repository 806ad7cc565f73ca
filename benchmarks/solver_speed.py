"""The measurements of `python -m benchmarks`: problems, whole frames, passes, scaling."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from benchmarks import solver_reference
from experiments.harness import Row, benchmark_exposure, best_seconds
from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import ActiveSet, Fidelity, Problem, Result, SaturationADMM, solve
from lightmatrix.solvers.active_set import prepared
from lightmatrix.solvers.problem import objective

# Number of rows of a timed correlation pass: full batches of every kernel.
PASS_ROWS = 96

# Work on one core is timed by the process's own time, so that other processes do not count.
Clock = Callable[[], float]
WALL, CORE = time.perf_counter, time.process_time


SCENES = ("l_objects", "gripper", "metal")
SIZE = (128, 128)
# Standard deviation of the noise, as a share of the clip level.
NOISE = 0.003
BITS = 8
# lambda as a share of the clip level, for every number of patterns: twice the default.
REGULARIZATION = 0.32


@cache
def exposed_truth(name: str, folder: Path | None = None) -> csr_array:
    """T of a scene at 128 x 128, times the benchmark exposure. Rendered on first use."""
    truth = library.truth(name, SIZE) if folder is None else Truth.load(folder / f"{name}.npz")
    return truth.matrix * np.float32(benchmark_exposure(truth.transport()))


@cache
def bernoulli(count: int, shape: tuple[int, int] = SIZE) -> BernoulliPatterns:
    return BernoulliPatterns(shape, count, seed=1)


def photographed(
    matrix: csr_array,
    patterns: PatternSet,
    *,
    clip: bool = True,
    regularization: float = REGULARIZATION,
    seed: int = 0,
) -> Problem:
    """The problem of the rows of an exposed T: noise, clipping (optional) and 8 bits."""
    light = irradiance(csr_array(matrix, dtype=np.float32), patterns)
    noise = np.random.default_rng(seed).normal(0, NOISE, light.shape)
    levels = np.rint((light + noise) * (2**BITS - 1))
    samples: NDArray[Any] = np.clip(levels, 0, None) / (2**BITS - 1)
    if clip:
        samples = np.minimum(samples, 1)
    clipped = samples >= 1 if clip else np.zeros(samples.shape, bool)
    ones = np.ones(patterns.count, np.float32)
    return Problem(patterns, Samples(samples.astype(np.float32), clipped, ones), regularization)


def spread(problem: Problem, rows: int) -> Problem:
    """The problem of some rows, evenly spread over the frame."""
    return problem.take(np.unique(np.linspace(0, problem.rows - 1, rows).astype(np.int64)))


def synthetic_truth(rows: int, pixels: int, seed: int = 0) -> csr_array:
    """Rows of three direct entries and a hundred weak ones, with the benchmark exposure."""
    rng = np.random.default_rng(seed)
    direct, tail = 3, 100
    columns = rng.integers(0, pixels, (rows, direct + tail))
    values = np.empty(columns.shape, np.float32)
    values[:, :direct] = rng.random((rows, direct)) * rng.lognormal(-1.5, 0.8, (rows, 1))
    values[:, direct:] = rng.exponential(1e-3, (rows, tail))
    matrix = csr_array(
        (values.ravel(), (np.repeat(np.arange(rows), direct + tail), columns.ravel())),
        shape=(rows, pixels),
    )
    matrix.sum_duplicates()
    level = np.quantile(matrix.max(axis=1).toarray(), 0.8)
    return matrix / np.float32(level)


def best_of(repeats: int, run: Callable[[], Any], clock: Clock = WALL) -> tuple[float, Any]:
    """The least time of several runs, and the last result."""
    results: list[Any] = []
    return best_seconds(lambda: results.append(run()), repeats, clock), results[-1]


def sgemm_seconds(patterns: PatternSet, rows: int, repeats: int = 5, clock: Clock = WALL) -> float:
    """The time of one correlation pass by BLAS in float32, per row."""
    e = np.random.default_rng(0).normal(size=(rows, patterns.count)).astype(np.float32)
    p = patterns.dense()
    seconds, _ = best_of(repeats, lambda: e @ p, clock)
    return seconds / rows


def whole_frame(problem: Problem, repeats: int = 3) -> Row:
    """Solve all rows of a frame on all cores, and compare with one SGEMM pass on all cores."""
    prepared(problem)
    seconds, result = best_of(repeats, lambda: solve(problem, ActiveSet()))
    sgemm = sgemm_seconds(problem.patterns, min(2048, problem.rows)) * problem.rows
    support = np.diff(result.coefficients.indptr)
    return {
        "patterns": problem.patterns.count,
        "regularization": problem.regularization,
        "seconds": seconds,
        "sgemm_seconds": sgemm,
        "ratio": seconds / sgemm,
        "certified": int(result.converged.sum()),
        "rows": problem.rows,
        "worst_gap": float(result.gap.max()),
        "passes": float(result.iterations.mean()),
        "support": float(support.mean()),
        "clipped": float(problem.samples.clipped.mean()),
    }


def on_one_core(problem: Problem) -> Row:
    """Solve the frame on one core, and check that all cores give the same rows bit for bit.

    The caller limits BLAS to one thread.
    """
    seconds, one = best_of(2, lambda: solve(problem, ActiveSet(threads=1)), CORE)
    many = solve(problem, ActiveSet())
    parts = (
        (r.coefficients.indices, r.coefficients.data, r.background, r.gap) for r in (many, one)
    )
    sgemm = sgemm_seconds(problem.patterns, min(1024, problem.rows), clock=CORE) * problem.rows
    return {
        "microseconds_per_row": 1e6 * seconds / problem.rows,
        "core_ratio": seconds / sgemm,
        "same_on_one_thread": all(np.array_equal(a, b) for a, b in zip(*parts, strict=True)),
    }


def agreement(problem: Problem, rows: int) -> Row:
    """Compare certified objectives with a long, independent float64 solve."""
    problem = spread(problem, rows)
    rough, fine = solve(problem, ActiveSet()), solve(problem, ActiveSet(tolerance=1e-6))
    dense = problem.patterns.dense().astype(np.float64)
    beyond, differences, reference_gaps = [], [], []
    for i in range(problem.rows):
        reference = solver_reference.solve_row(
            dense, problem.samples.values[i], problem.samples.clipped[i], problem.regularization
        )
        scale = max(reference.objective, 5e-7 * float((problem.samples.values[i] ** 2).sum()))
        # How far the distance from the reference exceeds the certified gap.
        excess = (rough.objective[i] - reference.objective) / scale - rough.gap[i]
        beyond.append(excess)
        differences.append(abs(fine.objective[i] - reference.objective) / scale)
        reference_gaps.append((reference.objective - reference.bound) / scale)
    return {
        "rows": problem.rows,
        "beyond_certified_gap": max(beyond),
        "objective_difference_at_1e-6": max(differences),
        "reference_gap": max(reference_gaps),
    }


def passes(count: int, repeats: int = 7) -> list[Row]:
    """Time a correlation pass for each instruction set and for Hadamard patterns, against SGEMM."""
    shape = SIZE
    bits = bernoulli(count)
    sets: list[tuple[str, PatternSet, str | None]] = [
        (f"tables, {name}", bits, name) for name in ("portable", "avx2", "avx512")
    ]
    sets.append(("tiles, amx", bits, "amx"))
    sets.append(("transform", HadamardPatterns(shape, count, order="random"), None))
    e = np.random.default_rng(0).normal(size=(PASS_ROWS, count))
    sgemm = sgemm_seconds(bits, 512, clock=CORE)
    table = []
    for name, patterns, instructions in sets:
        try:
            core = patterns.prepare(instructions=instructions)
        except ValueError:
            continue
        seconds, _ = best_of(repeats, partial(core.pass_only, e), CORE)
        table.append(
            {
                "patterns": count,
                "kernel": name,
                "microseconds_per_row": seconds / PASS_ROWS * 1e6,
                "sgemm_microseconds_per_row": sgemm * 1e6,
                "times_sgemm": sgemm * PASS_ROWS / seconds,
            }
        )
    return table


def scaling(sizes: tuple[int, ...], counts: tuple[int, ...], rows: int) -> list[Row]:
    """The cost of synthetic rows by projector size and number of patterns, on one core."""
    table = []
    for size in sizes:
        truth = synthetic_truth(rows, size * size)
        for count in counts:
            problem = photographed(truth, bernoulli(count, (size, size)))
            table.append(_scaling_row(problem, size))
    return table


def scaling_rows(size: int, count: int, rows: tuple[int, ...]) -> list[Row]:
    """The cost of a row by number of rows, on one core."""
    truth = synthetic_truth(max(rows), size * size)
    patterns = bernoulli(count, (size, size))
    problem = photographed(truth, patterns)
    return [_scaling_row(problem.take(np.arange(n)), size) for n in rows]


def _scaling_row(problem: Problem, size: int) -> Row:
    prepared(problem)
    seconds, result = best_of(3, lambda: solve(problem, ActiveSet(threads=1)), CORE)
    count = problem.patterns.count
    return {
        "size": size,
        "patterns": count,
        "rows": problem.rows,
        "microseconds_per_row": seconds / problem.rows * 1e6,
        "nanoseconds_per_pattern_pixel": seconds / problem.rows * 1e9 / (count * size * size),
        "certified": bool(result.converged.all()),
    }


def against_saturation_admm(problem: Problem, rows: int, share: float = 1e-3) -> Row:
    """Time until Saturation ADMM's mean objective is within `share` of the optimum, on one core."""
    problem = spread(problem, rows)
    seconds, exact = best_of(3, lambda: solve(problem, ActiveSet(threads=1)), CORE)
    for iterations in (50, 100, 200, 400, 800, 1600):
        solver = SaturationADMM(Fidelity.ONE_SIDED, max_iterations=iterations, tolerance=1e-9)
        admm_seconds, result = best_of(1, partial(solve, problem, solver), CORE)
        above = float(_repaired(problem, result).sum() / exact.objective.sum() - 1)
        if above <= share:
            break
    return {
        "rows": problem.rows,
        "microseconds_per_row": seconds / problem.rows * 1e6,
        "admm_iterations": iterations,
        "admm_microseconds_per_row": admm_seconds / problem.rows * 1e6,
        "admm_above_optimum": above,
        "times_faster": admm_seconds / seconds,
    }


def _repaired(problem: Problem, result: Result) -> Any:
    """The objectives of ADMM's rows after setting negative values to 0."""
    x = csr_array(result.coefficients.maximum(0))
    return objective(problem, x, np.maximum(result.background, 0), Fidelity.ONE_SIDED)
