"""Fig. 4: the paper's numerical simulation (Section 4.1), with two more methods.

Of 100 unknowns, 10 are not zero and uniform in [0, 1]; A is uniform in [0, 1]; there are 10 to 100
observations, unclipped or clipped at 3. The figure shows the mean and standard deviation of the
RMSE over the trials. Besides ROMP, ADMM and Saturation ADMM, it shows the convex one-sided variant
and the rejection of clipped samples. As in the paper, unknowns may be negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import Experiment, Measured, all_rows
from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.solvers import ADMM, ROMP, Fidelity, Problem, SaturationADMM, Solver, solve

UNKNOWNS = 100
NON_ZERO = 10
CLIP_LEVEL = 3.0
OBSERVATIONS = tuple(range(10, 101, 10))
# Trials for each number of observations.
TRIALS = 100
QUICK_TRIALS = 20

# The paper does not state these. lambda is small because there is no noise; mu and nu change the
# speed but not the solution.
REGULARIZATION = 0.01
PENALTY_X = 30.0
PENALTY_U = 3.0
ITERATIONS = 500
# The axis ends here; larger values are marked at its top. Chosen by eye.
_TOP = 0.45
# No row of a batch may stop before the others, so the tolerance is never reached.
_NEVER = 1e-300

_ADMM: dict[str, Any] = {"penalty_x": PENALTY_X, "max_iterations": ITERATIONS, "tolerance": _NEVER}
METHODS: dict[str, Solver] = {
    "romp": ROMP(sparsity=NON_ZERO, fidelity=Fidelity.LINEAR),
    "admm": ADMM(**_ADMM),
    "saturation-admm": SaturationADMM(Fidelity.CLIPPED, penalty_u=PENALTY_U, **_ADMM),
    "one-sided": SaturationADMM(Fidelity.ONE_SIDED, penalty_u=PENALTY_U, **_ADMM),
    "rejection": SaturationADMM(Fidelity.REJECTION, penalty_u=PENALTY_U, **_ADMM),
}
# Coinciding curves stay visible: wide and hollow ones lie below thin and small ones.
_STYLES: dict[str, dict[str, Any]] = {
    "romp": {"marker": "o", "markersize": 3},
    "admm": {"marker": "s", "markersize": 6, "markerfacecolor": "white", "linewidth": 2.6},
    "saturation-admm": {"marker": "o", "markersize": 3.5},
    "one-sided": {"marker": "+", "markersize": 8, "linestyle": "--"},
    "rejection": {"marker": "x", "markersize": 5, "linestyle": ":"},
}
SAME_WHERE_UNCLIPPED = ("one-sided", "rejection")
LABELS = {
    "romp": "ROMP",
    "admm": "ADMM",
    "saturation-admm": "Saturation ADMM",
    "one-sided": "one-sided (convex)",
    "rejection": "rejection",
}


@dataclass(frozen=True)
class Case:
    """All methods, unclipped and clipped, at one number of observations."""

    observations: int
    trials: int
    seed: int = 0

    @property
    def name(self) -> str:
        """A file name."""
        return f"k{self.observations}-{self.trials}-trials-s{self.seed}"


def cases(quick: bool) -> Iterator[Case]:
    """Every number of observations."""
    for observations in OBSERVATIONS:
        yield Case(observations, QUICK_TRIALS if quick else TRIALS)


def parameters(quick: bool) -> dict[str, Any]:
    """The parameters of the table."""
    return {
        "trials": QUICK_TRIALS if quick else TRIALS,
        "seed": 0,
        "unknowns": UNKNOWNS,
        "non_zero": NON_ZERO,
        "clip_level": CLIP_LEVEL,
        "lambda": REGULARIZATION,
        "mu": PENALTY_X,
        "nu": PENALTY_U,
        "iterations": ITERATIONS,
        "romp_n": NON_ZERO,
    }


def measure(case: Case) -> Measured:
    """Mean and standard deviation over the trials of each method's RMSE."""
    matrices, x = draw(case.trials, case.observations, case.seed)
    rows = []
    for condition, level in (("unclipped", np.inf), ("clipped", CLIP_LEVEL)):
        rmse: dict[str, NDArray[np.float64]] = {}
        for method in METHODS:
            # Without clipped samples these perform the same operations as Saturation ADMM.
            same = condition == "unclipped" and method in SAME_WHERE_UNCLIPPED
            known = rmse.get("saturation-admm") if same else None
            rmse[method] = errors(method, matrices, x, level) if known is None else known
            rows.append(
                {
                    "method": method,
                    "condition": condition,
                    "observations": case.observations,
                    "rmse_mean": float(rmse[method].mean()),
                    "rmse_std": float(rmse[method].std()),
                }
            )
    return Measured(rows)


def draw(
    trials: int, observations: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matrices (trials, K, 100) and sparse vectors (trials, 100)."""
    random = np.random.default_rng((seed, observations))
    matrices = random.random((trials, observations, UNKNOWNS))
    x = np.zeros((trials, UNKNOWNS))
    places = random.permuted(np.tile(np.arange(UNKNOWNS), (trials, 1)), axis=1)[:, :NON_ZERO]
    np.put_along_axis(x, places, random.random((trials, NON_ZERO)), axis=1)
    return matrices, x


def errors(
    method: str, matrices: NDArray[np.float64], x: NDArray[np.float64], clip_level: float
) -> NDArray[np.float64]:
    """RMSE of each trial, (trials,)."""
    linear = np.einsum("tkn,tn->tk", matrices, x)
    y = np.minimum(linear, clip_level)
    solver = METHODS[method]
    if isinstance(solver, ROMP):
        # The supports of trials differ, so a batch would gain nothing.
        solutions = [
            _solve(ImagePatterns(a[:, None, :].astype(np.float32)), row[None], clip_level, solver)
            for a, row in zip(matrices, y, strict=True)
        ]
        estimate = np.concatenate(solutions)
    else:
        estimate = _solve(TrialPatterns(matrices), y, clip_level, solver)
    return np.sqrt(np.mean((estimate - x) ** 2, axis=1))


@dataclass(frozen=True, eq=False)
class TrialPatterns(PatternSet):
    """One matrix A per trial, for solvers that process all rows at every step.

    Rows come in the order of the trials, equally many per trial. A solver must not stop single
    rows, because the remaining ones would no longer match their matrices.
    """

    # (trials, K, N)
    stack: NDArray[Any]

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]
        return 1, int(self.stack.shape[2])

    @property
    def count(self) -> int:  # type: ignore[override]
        return int(self.stack.shape[1])

    @cached_property
    def gram(self) -> NDArray[np.float64]:
        """A A' of each trial, (trials, K, K)."""
        stack = self.stack.astype(np.float64)
        return stack @ stack.transpose(0, 2, 1)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        return self._grouped(x, self.stack.transpose(0, 2, 1))

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        return self._grouped(e, self.stack)

    def _grouped(self, rows: NDArray[Any], matrices: NDArray[Any]) -> NDArray[Any]:
        groups = rows.reshape(len(matrices), -1, rows.shape[1])
        return (groups @ matrices.astype(rows.dtype, copy=False)).reshape(len(rows), -1)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        raise TypeError("trials share no columns")

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        raise TypeError("trials share no rows")

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "trials", "trials": len(self.stack), "count": self.count}


def _solve(
    patterns: TrialPatterns | ImagePatterns,
    y: NDArray[np.float64],
    clip_level: float,
    solver: Solver,
) -> NDArray[np.float64]:
    levels = np.full(patterns.count, clip_level)
    problem = Problem(
        patterns,
        Samples(y, y >= clip_level, levels),
        REGULARIZATION,
        nonnegative=False,
        background=False,
    )
    return solve(problem, solver).coefficients.toarray()


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    measured = all_rows(results)
    with figure(6.8, 3.0) as drawing:
        panels = drawing.subplots(1, 2)
        for axes, condition in zip(panels, ("unclipped", "clipped"), strict=True):
            for colour, (method, label) in zip(COLOURS, LABELS.items(), strict=False):
                rows = [
                    row
                    for row in measured
                    if row["method"] == method and row["condition"] == condition
                ]
                k = np.array([row["observations"] for row in rows])
                mean = np.array([row["rmse_mean"] for row in rows])
                spread = np.array([row["rmse_std"] for row in rows])
                axes.plot(k, mean, label=label, color=colour, **_STYLES[method])
                for place, value in zip(k[mean > _TOP], mean[mean > _TOP], strict=True):
                    axes.plot(place, 0.98 * _TOP, marker="^", color=colour)
                    where = {"xytext": (0, -12), "textcoords": "offset points", "ha": "center"}
                    text = f"{value:.1f}"
                    axes.annotate(text, (place, 0.98 * _TOP), **where, fontsize=7, color=colour)
                if condition == "unclipped" and method in SAME_WHERE_UNCLIPPED:
                    continue
                low, high = np.maximum(mean - spread, 0), mean + spread
                axes.fill_between(k, low, high, color=colour, alpha=0.07, linewidth=0)
            axes.set_xlabel("observations K")
            axes.set_xticks(OBSERVATIONS)
            axes.set_ylim(-0.01, _TOP)
        panels[0].set_ylabel("RMSE of x")
        panels[0].set_title("(a) unclipped")
        panels[1].set_title(f"(b) clipped at Y = {CLIP_LEVEL:g}")
        panels[0].legend(loc="upper right")
        note = f"mean and standard deviation of {results[0][0].trials} trials, "
        note += rf"$\lambda$ = {REGULARIZATION}, $\mu$ = {PENALTY_X:g}, "
        note += rf"$\nu$ = {PENALTY_U:g}, {ITERATIONS} iterations, ROMP n = {NON_ZERO}"
        drawing.supxlabel(note, fontsize=7, color="0.4")
        save(drawing, out, "fig4", ("png", "svg"))


FIG4 = Experiment("fig4", cases, measure, _draw, parameters)
