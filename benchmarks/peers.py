"""The solver against other packages, which know no clipping.

The problem is min lambda sum x + ||y - A x||^2 / 2, x >= 0, on unclipped rows. The background's
column is projected out of patterns and samples, which gives the same problem where b > 0. Each peer
gets this matrix in float64, with the loosest of several tolerances that reaches the gap on every
row. Times are those of the process on one core. Objectives and gaps are computed here for all
peers.
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
# A measurement is repeated as long as it takes less than this many seconds in all.
PATIENCE = 5.0
# Solves the rows with one setting (a tolerance or a number of iterations); returns x, (M, N).
Method = Callable[[float], Rows]


@dataclass(frozen=True)
class Outcome:
    """The accuracy of a method on all rows, and its time."""

    name: str
    setting: float
    seconds_per_row: float
    worst_gap: float
    mean_gap: float
    objective: float


class Centred:
    """A problem with its background projected out, dense and in float64."""

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
        """Objective and relative duality gap of each row, by definition."""
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
        """Time the first setting that reaches the gap on every row, or else the last setting."""
        method(settings[0])  # warms up compilers and caches
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
    """Rows with a positive background at the optimum, where all methods solve one problem."""
    result = solve(problem, ActiveSet(Fidelity.LINEAR))
    usable = np.flatnonzero(result.background > 1e-6)
    return problem.take(usable[np.linspace(0, len(usable) - 1, rows).astype(np.int64)])


def methods(centred: Centred) -> dict[str, tuple[Method, Sequence[float]]]:
    """All methods, each with its settings, loosest first."""
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

    # rho = 300 is the best of 0.3 to 300 at 256 patterns. The automatic choice diverges here.
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
