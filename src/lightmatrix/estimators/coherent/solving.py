"""How rows of the coherent estimate are solved: everywhere, or near what neighbours found."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.backgrounds import Backgrounds
from lightmatrix.estimators.coherent.neighbourhood import Neighbourhood, unseen_patterns
from lightmatrix.estimators.coherent.stages import Stage
from lightmatrix.estimators.steps import Progress
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.solvers.weighted import Candidates, Cells, Expectation, solve_weighted

# Of the clip level.
DEFAULT_REGULARIZATION = 0.1
# Of the clip level, and the gap: the first estimate, row by row, only has to show where light is.
FIRST_REGULARIZATION = 0.32
FIRST_TOLERANCE = 1e-2
# Regularizations are for patterns of this contrast, the standard deviation of their values, which
# random patterns have half of whose pixels are lit; for others they change in proportion.
USUAL_CONTRAST = 0.5
# Spots are no wider than this share of the projector's shorter side.
WIDEST = 1 / 16
# A row is explained if its objective is below this share of what an even background leaves of its
# samples. Measured on made-up scenes: .02 at most where the row is right, .4 at least where not.
UNEXPLAINED = 0.25
# Columns are no longer than their contrast times the root of their number, times this.
LONGEST = 1.5


@dataclass(frozen=True)
class Weighing:
    """The weighted problem of some rows: see `solve_weighted`, whose parameters these are."""

    problem: Problem
    candidates: Candidates
    cells: Cells
    expected: Expectation | None
    background: NDArray[np.float32]


@dataclass(frozen=True)
class Solving:
    """Rows of a capture and what they are solved with; see `CoherentEstimator`.

    `narrow` keeps the atoms' columns in half the memory.
    """

    capture: Capture
    solver: ActiveSet
    regularization: float | None
    trust: float
    candidates: int
    sizes: tuple[float, ...]
    background_grid: tuple[int, int]
    narrow: bool = False

    @cached_property
    def atoms(self) -> AtomPatterns:
        """What pixels and spots give under the patterns shown."""
        patterns = self.capture.patterns
        widest = WIDEST * min(patterns.shape)
        sizes = tuple(size for size in self.sizes if size <= widest)
        return AtomPatterns(patterns, sizes, narrow=self.narrow)

    @cached_property
    def unseen(self) -> AtomPatterns:
        """What they give under patterns that nobody shows."""
        atoms = self.atoms
        return AtomPatterns(unseen_patterns(atoms.shape), atoms.sizes, atoms.gains, self.narrow)

    @cached_property
    def level(self) -> float:
        """The clip level, in proportion to the contrast of the patterns."""
        contrast = self.atoms.single_contrast / USUAL_CONTRAST
        return self.capture.reference_level * (contrast or 1.0)

    @property
    def penalty(self) -> float:
        """The regularization of single pixels, as it is without spots."""
        given = self.regularization
        return DEFAULT_REGULARIZATION * self.level if given is None else given

    @cached_property
    def backgrounds(self) -> Backgrounds:
        """Cells of the background, no more than there are pixels."""
        shape = self.capture.projector_shape
        grid = min(self.background_grid[0], shape[0]), min(self.background_grid[1], shape[1])
        return Backgrounds(grid, self.capture.patterns, self.unseen.single)

    def everywhere(self, samples: Samples, progress: Progress | None = None) -> Result:
        """Rows that look at every atom, each for itself."""
        problem = self._problem(samples, FIRST_REGULARIZATION * self.level)
        solver = replace(self.solver, tolerance=max(FIRST_TOLERANCE, self.solver.tolerance))
        return solver.solve(problem, progress)

    def unexplained(self, samples: Samples, solved: Result) -> NDArray[np.int64]:
        """Rows whose samples are not explained by what was found, but might be by other atoms."""
        weights = samples.weights_of_all().astype(np.float64)
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
        means = (weights * samples.values).sum(axis=1, keepdims=True) / total
        left = (weights * (samples.values - means) ** 2).sum(axis=1)
        # Darker rows than this no atom can enter when they look everywhere.
        reach = LONGEST * self.atoms.single_contrast * np.sqrt(self.capture.count)
        bright = np.sqrt(left) * reach > FIRST_REGULARIZATION * self.level
        odd = solved.rows.diagnostics["objective"] > UNEXPLAINED * left / 2
        return np.flatnonzero(bright & odd)

    def weighing(
        self,
        samples: Samples,
        rows: NDArray[np.int64],
        stage: Stage,
        known: Neighbourhood,
    ) -> Weighing:
        """Rows, ascending, with penalties from what was found before."""
        assert stage.window is not None
        problem = self._problem(samples, self.penalty)
        first, last = int(rows[0]), int(rows[-1]) + 1
        if stage.expecting:
            first, last = known.around(first, last)
        halos = self.halos(known, first, last)
        expected = None
        if stage.expecting:
            light = known.rows.background[first:last]
            expected = self._expected(samples, rows, known, light * halos)
        unseen = expected is not None
        cells = Cells.none(self.capture.patterns, self.unseen if unseen else None)
        # Cells join in the last round, when it is clear where most of the light is.
        if stage.last:
            cost = self.level / problem.regularization
            cells = self.backgrounds.cells(cost, unseen=unseen)
        background = halos[rows - first, : cells.means.shape[1]]
        seen = samples.counted & ~samples.clipped
        likely = known.likely(
            stage.window,
            self.candidates,
            self.trust,
            seen.sum(axis=1),
            rows,
            first=stage.age == 1,
        )
        return Weighing(problem, likely, cells, expected, np.ascontiguousarray(background))

    def near(
        self,
        samples: Samples,
        rows: NDArray[np.int64],
        stage: Stage,
        known: Neighbourhood,
        progress: Progress | None = None,
    ) -> tuple[Result, Weighing]:
        """Rows, ascending, on their likeliest atoms, and the problem that they solve."""
        weighing = self.weighing(samples, rows, stage, known)
        solved = solve_weighted(
            weighing.problem,
            weighing.candidates,
            weighing.cells,
            self.solver,
            expected=weighing.expected,
            background=weighing.background,
            start=known.rows.rows(rows),
            progress=progress,
        )
        return solved, weighing

    def halos(self, known: Neighbourhood, start: int, stop: int) -> NDArray[np.float32]:
        """What the backgrounds of the rows start..stop give under shown and unseen patterns."""
        backgrounds = self.backgrounds
        return backgrounds.under_patterns(backgrounds.spread(csr_array(known.centres[start:stop])))

    def _expected(
        self,
        samples: Samples,
        rows: NDArray[np.int64],
        known: Neighbourhood,
        background: NDArray[np.float32],
    ) -> Expectation:
        """What neighbours' rows, and their backgrounds, say of the samples of some rows."""
        return known.expected(
            self.unseen,
            samples,
            samples.clipped & Fidelity(self.solver.fidelity).term.clip_aware,
            self.capture.reference_level,
            rows,
            background,
        )

    def _problem(self, samples: Samples, penalty: float) -> Problem:
        """Rows of atoms, for a penalty of single pixels."""
        return Problem(self.atoms, samples, penalty * self.atoms.gains[0])
