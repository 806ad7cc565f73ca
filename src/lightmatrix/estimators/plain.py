"""Row by row: every camera sample is estimated by itself, in tiles of bounded memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators import base
from lightmatrix.estimators.automatic_regularization import automatic_regularization
from lightmatrix.estimators.certainty import with_certainty
from lightmatrix.estimators.work import TILE_BYTES, ReadStep, SolveTile, Work, cut_rows
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_at_least_one
from lightmatrix.solvers import Solver, TotalVariation, solve
from lightmatrix.solvers.problem import Problem
from lightmatrix.transport.checkpoint import Span
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class PlainEstimator(base.Estimator):
    """Estimates T row by row with one solver.

    Parameters
    ----------
    solver : Solver
        ADMM, SaturationADMM, ROMP, ActiveSet or TotalVariation.
    regularization : float or None
        The paper's lambda in units of camera sample at exposure 1. None: 0.16 times the level that
        samples reach, or more where noise asks for it; of total variation, what noise asks for.
    nonnegative : bool
        Whether light is held to be not negative.
    background : bool
        Whether each camera sample has a coefficient of the patterns' means (diffuse light).
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte. Results do not depend on it.
    judged : bool
        Whether rows say if their strongest pixel is certain. T does not depend on it.
    """

    solver: Solver
    regularization: float | None = None
    nonnegative: bool = True
    background: bool = True
    tile_rows: int | None = None
    judged: bool = True

    name: ClassVar[str] = "row by row"

    def __post_init__(self) -> None:
        check_at_least_one(tile_rows=self.tile_rows)

    def plan(self, capture: Capture) -> base.Plan:
        """The estimate before it is made."""
        regularization = self.regularization
        if regularization is None:
            pictures = isinstance(self.solver, TotalVariation)
            regularization = automatic_regularization(capture, pictures=pictures)
        provenance = {
            "estimator": self.name,
            **base.solver_provenance(self.solver),
            "regularization": regularization,
            "nonnegative": self.nonnegative,
            "background": self.background,
            # What tiles hold depends on it.
            **({} if self.judged else {"judged": False}),
            **base.capture_provenance(capture),
        }
        return base.Plan(self.work(capture, regularization), provenance)

    def work(self, capture: Capture, regularization: float) -> Work:
        """The rows of a capture, in tiles."""
        return PlainRows(capture, self, regularization)

    def problem(self, patterns: PatternSet, samples: Samples, regularization: float) -> Problem:
        """The problem of some rows."""
        return Problem(
            patterns, samples, regularization, nonnegative=self.nonnegative,
            background=self.background,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlainRows(Work):
    """The rows of a capture, solved tile by tile."""

    capture: Capture
    estimator: PlainEstimator
    regularization: float

    def tiles(self, step: str, parts: int = 1) -> Iterator[Span]:
        patterns, solver = self.capture.patterns, self.estimator.solver
        row_bytes = solver.row_bytes(patterns.count, patterns.pixels)
        most = self.estimator.tile_rows or max(1, TILE_BYTES // row_bytes)
        return cut_rows(self.capture.rows, most, parts)

    def prepare(self, step: str, read: ReadStep) -> SolveTile:
        return self._solve

    def _solve(self, start: int, stop: int, progress: Progress) -> SparseRows:
        samples = self.capture.samples(start, stop)
        problem = self.estimator.problem(self.capture.patterns, samples, self.regularization)
        result = solve(problem, self.estimator.solver, progress=progress)
        rows = base.rows_with_diagnostics(samples, result).rounded()
        if not self.estimator.judged:
            return rows
        return with_certainty(rows, samples, problem.patterns, start, self.capture.rows)
