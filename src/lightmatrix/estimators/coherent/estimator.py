"""Spatially coherent estimation: camera pixels learn from their neighbours where their light is.

Neighbouring camera pixels look at neighbouring projector pixels. So each row is solved several
times, each time with penalties that its neighbours' rows, moved back, suggest: low where they found
light, high where they did not. The windows in which neighbours count shrink from round to round.
This is reweighted l1 minimisation (Candes, Wakin & Boyd 2008) with the weights of one row coming
from the rows around it. A row is explained by single pixels and by spots of several sizes, since
footprints out of focus are spots; which of them, neighbours agree on as they do on the place. And
what neighbours' rows would give in a row's place stands in for samples that clip or were never
taken. docs/few-patterns.md says what it is worth.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.rounds import Rounds
from lightmatrix.estimators.coherent.solving import Solving
from lightmatrix.estimators.coherent.stages import spacings, stages
from lightmatrix.estimators.join import (
    Crew,
    Plan,
    capture_provenance,
    joined,
    solver_provenance,
)
from lightmatrix.estimators.steps import Progress
from lightmatrix.ranges import check_at_least_one
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.transport.matrix import LightTransport

# Half widths of the windows of each round, in camera and in projector pixels. The first rounds
# gather evidence, the last ones settle it.
WINDOWS = ((2, 1), (2, 1), (2, 1), (2, 1), (1, 1), (1, 1), (1, 1), (1, 1))
# Standard deviations of spots in projector pixels; 0 is a single pixel. A size in between is a
# mixture of its neighbours.
SIZES = (0.0, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
# With more patterns than this the row by row estimate is good by itself, and much faster.
WORTH_IT_UP_TO = 256


@dataclass(frozen=True)
class CoherentEstimator:
    """Estimates T with penalties from neighbouring camera pixels, from few patterns.

    In each round row i is solved on its likeliest atoms j, pixels and spots, with the penalty
    ``2 lambda e / (e + s_ij)``, where s_i is the sum of the neighbours' rows, each moved back as
    footprints are measured to move, over its maximum and blurred by a window, relative to its
    strongest atom. From the third round on, rows have further samples, in place of clipped ones and
    under 64 patterns that were never shown: what the neighbours' rows, moved along and scaled,
    would give there. They weigh the less, the less the neighbours agree. Each row has a background,
    a halo around what was found of it; the last round also has coarse cells of projector pixels,
    for faint light from elsewhere.

    Parameters
    ----------
    regularization : float or None
        lambda: half the penalty of a pixel where no neighbour found light, in units of camera
        sample at exposure 1; that of a spot is less in proportion to its contrast under the
        patterns. None: 0.1 times the clip level of the longest exposure, for patterns whose values
        have a standard deviation of one half, and in proportion to it for others.
    trust : float
        e, > 0: how little light among the neighbours makes a pixel likely. The penalty of the
        likeliest pixel is about 2 lambda e. Rows of fewer than 32 known samples, and cameras
        coarser than the projector, rely more on neighbours: e is less in proportion. Faint light
        in rows that are mostly background needs up to seven times e.
    windows : tuple of (int, int)
        Half widths of the windows of each round, in camera and projector pixels.
    candidates : int
        Likeliest atoms kept of each row.
    sizes : tuple of float
        Standard deviations of the spots in projector pixels, ascending; the first is 0, a single
        pixel. Those wider than a sixteenth of the projector are left out.
    background_grid : (int, int)
        Rows and columns of the coarse cells; (1, 1) keeps one coefficient a row.
    fidelity : Fidelity
        one-sided, rejection or linear.
    tolerance : float
        Relative duality gap of the weighted problem of each row.
    max_passes : int
        Passes over a row's pixels, in each round, after which it is given up as it is.
    threads : int or None
        None takes one per core.
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte. Results do not depend on it.

    Raises
    ------
    InputError
        On parameters out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> lm.CoherentEstimator(windows=((1, 1),), candidates=20).estimate(capture).camera_shape
    (64, 64)
    """

    regularization: float | None = None
    trust: float = 0.01
    windows: tuple[tuple[int, int], ...] = WINDOWS
    candidates: int = 250
    sizes: tuple[float, ...] = SIZES
    background_grid: tuple[int, int] = (8, 8)
    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    tolerance: float = 1e-3
    max_passes: int = 200
    threads: int | None = None
    tile_rows: int | None = None

    def __post_init__(self) -> None:
        # The solver checks what it is given.
        object.__setattr__(self, "fidelity", self._solver.fidelity)
        if not self.trust > 0:
            raise InputError(f"a trust of {self.trust}", hint="use a small number such as 0.01")
        if not self.windows or min(min(pair) for pair in self.windows) < 0:
            raise InputError(
                f"windows of {self.windows}", hint="give half widths of one round or more"
            )
        check_at_least_one(candidates=self.candidates, tile_rows=self.tile_rows)
        if min(self.background_grid) < 1:
            raise InputError(
                f"a background grid of {self.background_grid}", hint="use (1, 1) or more"
            )

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
            The store to write. Finished tiles of each round are kept beside it, so that an
            interrupted run goes on where it stopped.
        overwrite : bool
            Whether a complete store at `checkpoint` may be replaced.
        progress : callable, optional
            Called with (done, total) rows; of all rounds, each counted by the time that it takes.
        crew : Crew, optional
            Other processes that solve the rows, see `lightmatrix.estimators.workers`.

        Returns
        -------
        LightTransport
            With the diagnostics clipped_share, iterations, converged, gap and objective per row;
            the gap is that of the weighted problem of the last round. And with footprint, the
            effective number of projector pixels that a camera pixel sees, and estimated_error, the
            relative error that a row states of itself: what an estimate without an eighth of the
            frames errs at these, noise apart; NaN below eight frames.

        Raises
        ------
        InputError, SolverError, OutputError
            On unusable captures or outputs that cannot be written.
        """
        plan = self.plan(capture, progress)
        return joined(plan, checkpoint=checkpoint, overwrite=overwrite, crew=crew)

    def plan(self, capture: Capture, progress: Progress | None = None) -> Plan:
        """The estimate before it is made; parameters are those of `estimate`."""
        rounds = stages(capture.camera_shape, capture.patterns.pixels, self.windows)
        solving = Solving(
            capture,
            self._solver,
            self.regularization,
            self.trust,
            self.candidates,
            self.sizes,
            self.background_grid,
            narrow=rounds[0].spacing > 1,
        )
        work = Rounds(solving, rounds, self.tile_rows, progress)
        provenance = self.provenance(capture, solving.penalty)
        return Plan(work, provenance, solving.backgrounds.grid)

    def provenance(self, capture: Capture, regularization: float) -> dict[str, Any]:
        """What made the estimate, JSON-ready."""
        made = solver_provenance(self._solver)
        made["solver_parameters"] |= {
            "trust": self.trust,
            "windows": [list(pair) for pair in self.windows],
            "candidates": self.candidates,
            "sizes": list(self.sizes),
        }
        certificate = (
            "the weighted problem of each row on its likeliest pixels, with expected samples"
        )
        steps = spacings(capture.camera_shape, capture.patterns.pixels, self.windows)
        if len(steps) > 1:
            made["solver_parameters"] |= {"spacings": list(steps)}
            certificate += "; that of some rows, evenly spread, against all pixels too"
        return {
            "estimator": "coherent",
            **made,
            "regularization": regularization,
            "certificate": certificate,
            **capture_provenance(capture),
        }

    @property
    def _solver(self) -> ActiveSet:
        return ActiveSet(self.fidelity, self.tolerance, self.max_passes, self.threads)
