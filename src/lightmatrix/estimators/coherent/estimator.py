"""The coherent estimator and its parameters; the package explains the algorithm."""

from __future__ import annotations

from dataclasses import dataclass

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import PASSES
from lightmatrix.errors import InputError
from lightmatrix.estimators.base import Estimator, Plan, capture_provenance, solver_provenance
from lightmatrix.estimators.coherent.rounds import Rounds
from lightmatrix.estimators.coherent.row_solver import RowSolver, coherent_row_bytes
from lightmatrix.estimators.coherent.schedule import schedule, spacings
from lightmatrix.estimators.work import TILE_BYTES
from lightmatrix.ranges import check_at_least_one
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity

# Half widths of the windows of each round, in camera and in projector pixels. The wide windows of
# the first rounds gather evidence, the narrow ones of the last rounds settle it. Errors are flat
# around these values (docs/coherent.md).
WINDOWS = ((2, 1), (2, 1), (2, 1), (2, 1), (1, 1), (1, 1), (1, 1), (1, 1))
# Standard deviations of the spots in projector pixels; 0 is a single pixel. Each is about 1.4 times
# the one before, so that a mixture of two of them comes close to any size between.
SIZES = (0.0, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.3)


@dataclass(frozen=True)
class CoherentEstimator(Estimator):
    """Estimates T with penalties from neighbouring camera pixels, from few patterns.

    Each round solves row i on its likeliest atoms j with the penalty ``2 lambda e / (e + s_ij)``;
    the package `lightmatrix.estimators.coherent` explains the rounds.

    The gap of a row is that of the weighted problem of the last round. Further diagnostics are
    footprint, the effective number of projector pixels that a camera pixel sees, and
    estimated_error, the estimated relative error of the row: the error of an estimate without an
    eighth of the frames at these frames, less the noise; NaN below eight frames. What no frame held
    out shows is in constant_light, the share of the row's light that does not follow the patterns,
    bend, how far residuals bend with the prediction (both NaN for all but 4,096 rows),
    only_bounded, whether the row clips whenever its strongest projector pixel is lit, and glint,
    whether it clips in most frames too. Progress counts all rounds, each by the time that it
    usually takes.

    Parameters
    ----------
    regularization : float or None
        lambda: half the penalty of a pixel where no neighbour has light, in units of camera
        sample at exposure 1. The penalty of a spot is lower in proportion to its contrast under the
        patterns. None: 0.1 times the clip level of the longest exposure, for patterns whose values
        have a standard deviation of one half, and in proportion to it for others.
    trust : float
        e, > 0: how little light among the neighbours makes a pixel likely. The penalty of the
        likeliest pixel is about 2 lambda e. Rows of fewer than 32 known samples, and cameras
        coarser than the projector, rely more on neighbours: e is less in proportion.
    windows : tuple of (int, int)
        Half widths of the windows of each round, in camera and projector pixels.
    candidates : int
        Likeliest atoms kept of each row.
    sizes : tuple of float
        Standard deviations of the spots in projector pixels, ascending; the first is 0, a single
        pixel. Those wider than 4, or a sixteenth of the projector, are left out, but in
        photographs of little contrast only those wider than an eighth of it.
    background_grid : (int, int)
        Rows and columns of the coarse cells; (1, 1) keeps one coefficient a row.
    fidelity : Fidelity
        one-sided, rejection or linear.
    tolerance : float
        Relative duality gap of the weighted problem of each row.
    max_passes : int
        Passes over a row's pixels in each round, after which it stays as it is.
    threads : int or None
        Threads of the solver. None: one per core.
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte. Results do not depend on it.
    judged : bool
        Whether rows have the diagnostics that say how far to trust them, such as estimated_error. T
        does not depend on it.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    regularization: float | None = None
    trust: float = 0.01
    windows: tuple[tuple[int, int], ...] = WINDOWS
    candidates: int = 250
    sizes: tuple[float, ...] = SIZES
    background_grid: tuple[int, int] = (8, 8)
    fidelity: Fidelity | str = Fidelity.ONE_SIDED
    tolerance: float = 1e-3
    max_passes: int = PASSES
    threads: int | None = None
    tile_rows: int | None = None
    judged: bool = True

    def __post_init__(self) -> None:
        # The solver checks its own parameters.
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

    def plan(self, capture: Capture) -> Plan:
        """The estimate before it is made."""
        rounds = schedule(capture.camera_shape, capture.patterns.pixels, self.windows)
        solver = self.row_solver(capture, narrow=rounds[0].spacing > 1)
        work = Rounds(solver, rounds, self.tile_rows, self.judged)
        return Plan(work, self._provenance(capture, solver), solver.backgrounds.grid)

    def row_solver(self, capture: Capture, *, narrow: bool = False) -> RowSolver:
        """What solves rows of a capture with these parameters."""
        own = self._solver, self.regularization, self.trust, self.candidates, self.sizes
        most = self.tile_rows or TILE_BYTES // coherent_row_bytes(capture.count, self.candidates)
        return RowSolver(capture, *own, self.background_grid, narrow, max(1, most // 4))

    def _provenance(self, capture: Capture, solver: RowSolver) -> dict[str, object]:
        made_by = solver_provenance(self._solver)
        made_by["solver_parameters"] |= {
            "trust": self.trust, "windows": [list(pair) for pair in self.windows],
            "candidates": self.candidates, "sizes": list(solver.atoms.sizes),
        }  # fmt: skip
        steps = spacings(capture.camera_shape, capture.patterns.pixels, self.windows)
        if len(steps) > 1:
            made_by["solver_parameters"] |= {"spacings": list(steps)}
        return {
            "estimator": "coherent",
            **made_by,
            "regularization": solver.penalty,
            "certificate": (
                "the weighted problem of each row on its likeliest pixels, with expected samples"
            ),
            # What tiles hold depends on it.
            **({} if self.judged else {"judged": False}),
            **capture_provenance(capture),
        }

    @property
    def _solver(self) -> ActiveSet:
        return ActiveSet(self.fidelity, self.tolerance, self.max_passes, self.threads)
