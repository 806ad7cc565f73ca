"""Row by row: every camera sample estimated for itself, in tiles of bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.join import (
    TILE_BYTES,
    Crew,
    Plan,
    capture_provenance,
    joined,
    kept,
    solver_provenance,
)
from lightmatrix.estimators.regularization import automatic_regularization
from lightmatrix.estimators.steps import OneStep, Progress, cut
from lightmatrix.ranges import check_at_least_one
from lightmatrix.solvers import Solver, solve
from lightmatrix.solvers.problem import Problem
from lightmatrix.store import ROWS
from lightmatrix.store.tiles import Span
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class PlainEstimator:
    """Estimates T row by row with one solver.

    Parameters
    ----------
    solver : Solver
        ADMM, SaturationADMM, ROMP or ActiveSet.
    regularization : float or None
        The paper's lambda in units of camera sample at exposure 1. None: 0.16 times the level that
        samples reach, or more where noise asks for it (see `automatic_regularization`).
    nonnegative : bool
        Whether light is held to be not negative.
    background : bool
        Whether each camera sample has a coefficient of the patterns' means (diffuse light).
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte. Results do not depend on it.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> lm.PlainEstimator(lm.ROMP(max_iterations=2)).estimate(capture).camera_shape
    (64, 64)
    """

    solver: Solver
    regularization: float | None = None
    nonnegative: bool = True
    background: bool = True
    tile_rows: int | None = None

    def __post_init__(self) -> None:
        check_at_least_one(tile_rows=self.tile_rows)

    def estimate(
        self,
        capture: Capture,
        *,
        checkpoint: Path | None = None,
        overwrite: bool = False,
        progress: Progress | None = None,
        crew: Crew | None = None,
    ) -> LightTransport:
        """From a capture to its light transport matrix.

        Parameters
        ----------
        capture : Capture
            M camera samples under K patterns of N projector pixels.
        checkpoint : Path, optional
            The store to write. Finished tiles are kept beside it, so that an interrupted run goes
            on where it stopped.
        overwrite : bool
            Whether a complete store at `checkpoint` may be replaced.
        progress : callable, optional
            Called with (done, total) rows.
        crew : Crew, optional
            Other processes that solve the rows, see `lightmatrix.estimators.workers`.

        Returns
        -------
        LightTransport
            With the diagnostics clipped_share, iterations, converged, gap and objective per row.

        Raises
        ------
        InputError, SolverError, OutputError
            On unusable captures, problems the solver cannot treat, or outputs it cannot write.
        """
        plan = self.plan(capture, progress)
        return joined(plan, checkpoint=checkpoint, overwrite=overwrite, crew=crew)

    def plan(self, capture: Capture, progress: Progress | None = None) -> Plan:
        """The estimate before it is made; parameters are those of `estimate`."""
        regularization = self._regularization(capture)
        work = _Tiles(capture, progress, self, regularization)
        return Plan(work, self.provenance(capture, regularization))

    def provenance(self, capture: Capture, regularization: float) -> dict[str, Any]:
        """What made the estimate, JSON-ready."""
        return {
            "estimator": "plain",
            **solver_provenance(self.solver),
            "regularization": regularization,
            "nonnegative": self.nonnegative,
            "background": self.background,
            **capture_provenance(capture),
        }

    def _regularization(self, capture: Capture) -> float:
        if self.regularization is not None:
            return self.regularization
        return automatic_regularization(capture)


@dataclass(frozen=True, eq=False)
class _Tiles(OneStep):
    """The rows of a capture, solved tile by tile."""

    estimator: PlainEstimator
    regularization: float

    def ranges(self, step: str, parts: int = 1, *, shrinking: bool = False) -> Iterator[Span]:
        most = self.estimator.tile_rows or self._fitting_rows()
        return cut(self.capture.rows, most, parts, shrinking)

    def solve(self, start: int, stop: int) -> SparseRows:
        samples = self.capture.samples(start, stop)
        problem = Problem(
            self.capture.patterns,
            samples,
            self.regularization,
            nonnegative=self.estimator.nonnegative,
            background=self.estimator.background,
        )
        report = self.report(ROWS, start)
        return kept(samples, solve(problem, self.estimator.solver, progress=report))

    def _fitting_rows(self) -> int:
        patterns = self.capture.patterns
        return max(
            1, TILE_BYTES // self.estimator.solver.row_bytes(patterns.count, patterns.pixels)
        )
