"""Peers on the problem they know: unclipped rows, min lambda sum x + ||y - A x||^2 / 2, x >= 0.

The background column is projected out of patterns and samples, which is the same problem wherever
b > 0; each peer gets that matrix in float64 and, from a ladder of tolerances, the loosest that
reaches the gap on every row. Times are those of the process on one core. Objectives and gaps are
recomputed here, alike for all.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.solvers import ADMM, ActiveSet, Fidelity, Problem, SaturationADMM, solve

Rows = NDArray[np.float64]
# Repeats of a measurement end before they take more seconds than this.
PATIENCE = 5.0
# Solves rows (M, K) to a setting of the peer's own; returns x (M, N).
Method = Callable[[float], Rows]


@dataclass(frozen=True)
class Outcome:
    """What a method reached on all rows, and the time it took."""

    name: str
    setting: float
    seconds_per_row: float
    worst_gap: float
    mean_gap: float
    objective: float


class Centred:
    """A problem without its background, dense and in float64."""

    def __init__(self, problem: Problem) -> None:
        dense = problem.patterns.dense().astype(np.float64)
        means = dense.mean(axis=1)
        unit = means / np.linalg.norm(means)
        self.problem = problem
        self.matrix = np.asfortranarray(dense - np.outer(unit, unit @ dense))
        samples = problem.samples.values.astype(np.float64)
        self.samples = samples - np.outer(samples @ unit, unit)
        self.lam = problem.regularization

    def objective_and_gap(self, x: Rows) -> tuple[Rows, Rows]:
        """Objective and relative duality gap of each row, from their definitions."""
        r = self.samples - x @ self.matrix.T
        primal = self.lam * x.sum(axis=1) + (r**2).sum(axis=1) / 2
        most = np.maximum((r @ self.matrix).max(axis=1), 1e-300)
        linear, square = (self.samples * r).sum(axis=1), np.maximum((r**2).sum(axis=1), 1e-300)
        scale = np.clip(linear / square, 0, self.lam / most)
        dual = scale * linear - scale**2 * square / 2
        return primal, (primal - dual) / np.maximum(primal, 1e-300)

    def run(
        self, name: str, method: Method, settings: Sequence[float], gap: float, repeats: int = 3
    ) -> Outcome:
        """The first setting that reaches the gap on every row, or the last one; best of repeats."""
        method(settings[0])  # compilers and caches are warm before the clock starts
        for setting in settings:
            seconds, spent = np.inf, 0.0
            for repeat in range(repeats):
                started = time.process_time()
                x = method(setting)
                took = time.process_time() - started
                seconds, spent = min(seconds, took), spent + took
                if spent * (repeat + 2) / (repeat + 1) > PATIENCE:
                    break
            objective, gaps = self.objective_and_gap(np.maximum(x, 0))
            if gaps.max() <= gap:
                break
        return Outcome(
            name,
            setting,
            seconds / len(x),
            float(gaps.max()),
            float(gaps.mean()),
            float(objective.mean()),
        )


def with_active_rows(problem: Problem, rows: int) -> Problem:
    """Rows whose background is positive at the optimum: there all methods solve one problem."""
    result = solve(problem, ActiveSet(Fidelity.LINEAR))
    usable = np.flatnonzero(result.background > 1e-6)
    return problem.take(usable[np.linspace(0, len(usable) - 1, rows).astype(np.int64)])


def methods(centred: Centred) -> dict[str, tuple[Method, Sequence[float]]]:
    """Each method with its ladder of settings, loosest first."""
    known: dict[str, tuple[Callable[[Centred, float], Rows], Sequence[float]]] = {
        "active set": (_active_set, (1e-4,)),
        "celer": (_celer, (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)),
        "skglm": (_skglm, (1e-3, 1e-4, 1e-5, 1e-6)),
        "scikit-learn": (_sklearn, (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)),
        "SPORCO BPDN": (_sporco, (300, 1000)),
        "ADMM": (_admm, (300, 1000)),
        "Saturation ADMM": (_saturation_admm, (300, 1000)),
    }
    return {name: (partial(run, centred), ladder) for name, (run, ladder) in known.items()}


def _active_set(centred: Centred, tolerance: float) -> Rows:
    solver = ActiveSet(Fidelity.LINEAR, tolerance=tolerance, threads=1)
    return solve(centred.problem, solver).coefficients.toarray()


def _each_row(centred: Centred, fit: Callable[[Rows, Rows], Rows]) -> Rows:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.stack([fit(centred.matrix, y) for y in centred.samples])


def _celer(centred: Centred, tolerance: float) -> Rows:
    from celer import Lasso

    alpha = centred.lam / len(centred.matrix)
    model = Lasso(alpha, positive=True, fit_intercept=False, tol=tolerance)
    return _each_row(centred, lambda a, y: model.fit(a, y).coef_)


def _skglm(centred: Centred, tolerance: float) -> Rows:
    from skglm import Lasso

    alpha = centred.lam / len(centred.matrix)
    model = Lasso(alpha, positive=True, fit_intercept=False, tol=tolerance * alpha)
    return _each_row(centred, lambda a, y: model.fit(a, y).coef_)


def _sklearn(centred: Centred, tolerance: float) -> Rows:
    from sklearn.linear_model import Lasso

    alpha = centred.lam / len(centred.matrix)
    model = Lasso(alpha, positive=True, fit_intercept=False, tol=tolerance, max_iter=100_000)
    return _each_row(centred, lambda a, y: model.fit(a, y).coef_)


def _sporco(centred: Centred, iterations: float) -> Rows:
    from sporco.admm.bpdn import BPDN

    # Of the penalties 0.3 to 300 the best at 256 patterns; the automatic one diverges here.
    options = BPDN.Options(
        {
            "Verbose": False,
            "MaxMainIter": int(iterations),
            "NonNegCoef": True,
            "RelStopTol": 1e-6,
            "rho": 300.0,
            "AutoRho": {"Enabled": False},
        }
    )
    solver = BPDN(centred.matrix, centred.samples.T.copy(), centred.lam, options)
    return np.asarray(solver.solve()).T


def _admm(centred: Centred, iterations: float) -> Rows:
    solver = ADMM(max_iterations=int(iterations), tolerance=1e-6)
    return _dense(solve(centred.problem, solver).coefficients)


def _saturation_admm(centred: Centred, iterations: float) -> Rows:
    solver = SaturationADMM(Fidelity.LINEAR, max_iterations=int(iterations), tolerance=1e-6)
    return _dense(solve(centred.problem, solver).coefficients)


def _dense(x: Any) -> Rows:
    return np.asarray(x.toarray(), np.float64)
