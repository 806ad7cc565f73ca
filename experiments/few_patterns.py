"""How few patterns suffice: coherent estimates of the rendered scenes and row-by-row ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from experiments.harness import Experiment, Measured, Row, all_rows, means
from experiments.measured_scene import (
    ONE_EXPOSURE,
    SCENES,
    THREE_EXPOSURES,
    Exposures,
    MeasuredScene,
    measured_scene,
)
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_solver import DEFAULT_REGULARIZATION
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.mix import MixedPatterns, default_mix
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, save
from lightmatrix.simulation import library
from lightmatrix.solvers import ActiveSet, Problem
from lightmatrix.solvers.active_set import Candidates, Cells, solve_weighted
from lightmatrix.transport.matrix import LightTransport

SIZE = (128, 128)
SEEDS = (0, 1, 2)
HALF_EXPOSURE: Exposures = ((0.5, 1.0),)
TWO_EXPOSURES: Exposures = ((1.0, 0.75), (0.25, 0.25))
# "Known support" solves each row on the entries of the truth above this share of the clip level,
# with this multiple of the coherent estimate's regularization. Chosen by hand.
KNOWN_SUPPORT = 0.003
KNOWN_PENALTY = 0.01
ERROR_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1)


@dataclass(frozen=True)
class Case:
    """One estimate of one capture."""

    scene: str
    method: str
    patterns: int
    seed: int
    mix: bool = False
    exposures: Exposures = ONE_EXPOSURE
    size: tuple[int, int] = SIZE

    @property
    def name(self) -> str:
        """A file name."""
        parts = [self.scene, f"{self.size[0]}", self.method, f"k{self.patterns}", f"s{self.seed}"]
        exposures = "".join(f"e{exposure:g}" for exposure, _ in self.exposures)
        return "-".join([*parts, *["mix"] * self.mix, exposures])


def cases(quick: bool) -> Iterator[Case]:
    """All cases, the cheap and important ones first."""
    if quick:
        for method in ("coherent", "row by row"):
            yield Case("l_objects", method, 32, 0, size=(64, 64))
        return
    for seed in SEEDS:
        for scene in SCENES:
            for count in (16, 32, 64):
                for method in ("coherent", "row by row"):
                    yield Case(scene, method, count, seed)
            for count in (16, 32):
                yield Case(scene, "coherent", count, seed, exposures=HALF_EXPOSURE)
            yield Case(scene, "coherent", 64, seed, mix=True)
            for exposures in (TWO_EXPOSURES, THREE_EXPOSURES):
                yield Case(scene, "coherent", 64, seed, exposures=exposures)
            for exposures in (TWO_EXPOSURES, THREE_EXPOSURES):
                yield Case(scene, "coherent", 64, seed, mix=True, exposures=exposures)
            for count in (128, 256):
                yield Case(scene, "row by row", count, seed)
    for scene in SCENES:
        for count in (16, 32, 64, 256):
            yield Case(scene, "known support", count, 0)
            yield Case(scene, "not clipping", count, 0)
    # These show that coherent is no worse than row by row at any number of patterns.
    for count in (32, 64, 128, 256, 512, 1024):
        for scene in library.BUNDLED:
            for seed in SEEDS:
                for method in ("coherent", "row by row"):
                    yield Case(scene, method, count, seed, size=(64, 64))
    for seed in SEEDS:
        for scene in SCENES:
            for count in (128, 256):
                yield Case(scene, "coherent", count, seed)


def summary(rows: list[Row]) -> list[Row]:
    """The means over the seeds."""
    keys = [name for name in asdict(Case("", "", 0, 0)) if name != "seed"]
    values = [name for name in rows[0] if name not in (*keys, "seed")]
    return means(rows, keys, values)


def measure(case: Case) -> Measured:
    """Errors and time of one case."""
    scene = measured_scene(case.scene, case.size[0])
    patterns = _patterns(case)
    capture = scene.capture(patterns, case.seed, case.exposures)
    started = time.perf_counter()
    estimate = _estimate(case, scene, capture)
    seconds = time.perf_counter() - started
    # At every exposure the errors cover the same rows.
    usual = capture if case.exposures == ONE_EXPOSURE else scene.capture(patterns, case.seed)
    certified = estimate.diagnostics.get("converged", np.array([np.nan]))
    row = {
        **asdict(case),
        **scene.errors(estimate, usual),
        "certified": float(np.mean(certified)),
        "seconds": seconds,
    }
    return Measured([row])


def _estimate(case: Case, scene: MeasuredScene, capture: Capture) -> LightTransport:
    if case.method == "coherent":
        return CoherentEstimator().estimate(capture)
    if case.method == "row by row":
        return PlainEstimator(ActiveSet()).estimate(capture)
    if case.method == "not clipping":
        clean = scene.capture(capture.patterns, case.seed, case.exposures, clipping=False)
        return CoherentEstimator().estimate(clean)
    return _with_known_support(scene, capture)


def _with_known_support(scene: MeasuredScene, capture: Capture) -> LightTransport:
    """Solve each row on the pixels that hold light in the truth."""
    level = capture.reference_level
    support = scene.truth.matrix.copy()
    support.data[support.data < KNOWN_SUPPORT * level] = 0
    support.eliminate_zeros()
    support.sort_indices()
    samples = capture.samples()
    problem = Problem(capture.patterns, samples, KNOWN_PENALTY * DEFAULT_REGULARIZATION * level)
    candidates = Candidates(
        support.indptr.astype(np.int64),
        support.indices.astype(np.int32),
        np.ones(support.nnz, np.float32),
    )
    solved = solve_weighted(
        problem, candidates, Cells.none(capture.patterns), ActiveSet(tolerance=1e-3)
    )
    return LightTransport(
        csr_array(solved.coefficients, dtype=np.float32),
        solved.background.astype(np.float32)[:, None],
        capture.camera_shape,
        capture.projector_shape,
        diagnostics={"converged": solved.converged},
    )


def _patterns(case: Case) -> PatternSet:
    if case.mix:
        return MixedPatterns(
            case.size, case.patterns, default_mix(case.size, case.patterns), seed=case.seed
        )
    return BernoulliPatterns(case.size, case.patterns, seed=case.seed)


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """Draw the curves of a full run; a quick one has none."""
    rows = summary(all_rows(results))
    if {row["scene"] for row in rows} != set(SCENES):
        return
    kinds = (
        ("row by row", "row by row", COLOURS[6], "-"),
        ("coherent", "coherent", COLOURS[0], "-"),
        ("not clipping", "coherent, camera that does not clip", COLOURS[2], "--"),
        ("known support", "support known", COLOURS[1], ":"),
    )
    with figure(7.2, 4.7) as drawing:
        panels = drawing.subplots(2, len(SCENES), sharex=True, sharey="row")
        for column, (scene, title) in enumerate(SCENES.items()):
            for line, error in enumerate(("relative_error", "relighting_error")):
                axes = panels[line, column]
                for method, label, colour, style in kinds:
                    points = sorted(
                        (row["patterns"], row[error])
                        for row in rows
                        if row["scene"] == scene
                        and row["method"] == method
                        and not row["mix"]
                        and tuple(map(tuple, row["exposures"])) == ONE_EXPOSURE
                        and row["size"][0] == SIZE[0]
                    )
                    k, value = zip(*points, strict=True)
                    axes.plot(k, value, style, color=colour, marker="o", markersize=3, label=label)
                axes.set_xscale("log", base=2)
                axes.set_yscale("log")
                fix_ticks(axes.yaxis, ERROR_TICKS)
                axes.grid(axis="y", color="0.92", linewidth=0.6)
                axes.set_xticks([16, 32, 64, 128, 256], ["16", "32", "64", "128", "256"])
            panels[0, column].set_title(title)
            panels[1, column].set_xlabel("patterns K")
        panels[0, 0].set_ylabel("relative error of T")
        panels[1, 0].set_ylabel("relighting error")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=4)
        save(drawing, out, "few-patterns", ("png", "svg"))


FEW_PATTERNS = Experiment("few-patterns", cases, measure, _draw, summary=summary)
