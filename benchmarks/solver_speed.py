"""The measurements of `python -m benchmarks`: whole frames, passes, scaling, agreement."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from benchmarks import solver_reference, solver_rows
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers import ActiveSet, Fidelity, Problem, Result, SaturationADMM, solve
from lightmatrix.solvers.active_set import prepared
from lightmatrix.solvers.problem import objective

Row = dict[str, Any]
# Number of rows of a timed correlation pass: full batches of every kernel.
PASS_ROWS = 96

# Work on one core is timed by the process's own time, so that other processes do not count.
Clock = Callable[[], float]
WALL, CORE = time.perf_counter, time.process_time


def best_of(repeats: int, run: Callable[[], Any], clock: Clock = WALL) -> tuple[float, Any]:
    """The least time of several runs, and the last result."""
    best = np.inf
    for _ in range(repeats):
        started = clock()
        result = run()
        best = min(best, clock() - started)
    return best, result


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
    problem = solver_rows.spread(problem, rows)
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
    shape = solver_rows.SIZE
    bits = solver_rows.bernoulli(count)
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
        truth = solver_rows.synthetic_truth(rows, size * size)
        for count in counts:
            problem = solver_rows.photographed(truth, solver_rows.bernoulli(count, (size, size)))
            table.append(_scaling_row(problem, size))
    return table


def scaling_rows(size: int, count: int, rows: tuple[int, ...]) -> list[Row]:
    """The cost of a row by number of rows, on one core."""
    truth = solver_rows.synthetic_truth(max(rows), size * size)
    patterns = solver_rows.bernoulli(count, (size, size))
    problem = solver_rows.photographed(truth, patterns)
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
    problem = solver_rows.spread(problem, rows)
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
