"""Solves rows of the coherent estimate: on all atoms, or on the likely ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.backgrounds import Backgrounds
from lightmatrix.estimators.coherent.neighbourhood import Neighbourhood, unseen_patterns
from lightmatrix.estimators.coherent.schedule import Round
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.resources.computed_once import computed_once
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.loop import Progress
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.solvers.weighted import Candidates, Cells, PseudoSamples, solve_weighted

# lambda relative to the clip level. Errors are flat around it: three times as much or as little
# changes them by about a tenth (docs/few-patterns.md).
DEFAULT_REGULARIZATION = 0.1
# lambda relative to the clip level, and the relative gap, of the first round. They are rougher, as
# this round only has to show where light may be. Chosen by hand.
FIRST_REGULARIZATION = 0.32
FIRST_TOLERANCE = 1e-2
# Passes over all atoms of the first round of a small frame, in which every row has neighbours that
# have searched, too. Until the gap is reached there would be 3.5, with the same errors
# (docs/measurements.md).
FIRST_PASSES = 2
# The contrast of patterns that regularizations are for, the standard deviation of their values.
# Random patterns with half of the pixels lit have it; for others lambda changes in proportion.
USUAL_CONTRAST = 0.5
# The standard deviation of a spot is at most this share of the projector's shorter side. Chosen by
# hand.
WIDEST = 1 / 16
# The norm of an atom's column is at most this times its contrast times the root of the number of
# patterns. Chosen by hand.
LONGEST = 1.5


@dataclass(frozen=True)
class WeightedRows:
    """The weighted problem of some rows; the fields are parameters of `solve_weighted`."""

    problem: Problem
    candidates: Candidates
    cells: Cells
    pseudo_samples: PseudoSamples | None
    background: NDArray[np.float32]


@dataclass(frozen=True)
class RowSolver:
    """Solves rows with `CoherentEstimator`'s parameters; `narrow` halves the memory of columns."""

    capture: Capture
    solver: ActiveSet
    regularization: float | None
    trust: float
    candidates: int
    sizes: tuple[float, ...]
    background_grid: tuple[int, int]
    narrow: bool = False

    @computed_once
    def atoms(self) -> AtomPatterns:
        """Pixels and spots under the patterns shown."""
        patterns = self.capture.patterns
        widest = WIDEST * min(patterns.shape)
        sizes = tuple(size for size in self.sizes if size <= widest)
        return AtomPatterns(patterns, sizes, narrow=self.narrow)

    @computed_once
    def unseen(self) -> AtomPatterns:
        """Pixels and spots under the patterns that were never shown."""
        atoms = self.atoms
        return AtomPatterns(unseen_patterns(atoms.shape), atoms.sizes, atoms.gains, self.narrow)

    @computed_once
    def level(self) -> float:
        """The clip level, in proportion to the contrast of the patterns."""
        contrast = self.atoms.single_contrast / USUAL_CONTRAST
        return self.capture.reference_level * (contrast or 1.0)

    @property
    def penalty(self) -> float:
        """The regularization of single pixels."""
        if self.regularization is None:
            return DEFAULT_REGULARIZATION * self.level
        return self.regularization

    @computed_once
    def backgrounds(self) -> Backgrounds:
        """The cells of the background, at most one a pixel."""
        shape = self.capture.projector_shape
        grid = min(self.background_grid[0], shape[0]), min(self.background_grid[1], shape[1])
        return Backgrounds(grid, self.capture.patterns, self.unseen.single)

    def everywhere(
        self, samples: Samples, progress: Progress | None = None, *, brief: bool = False
    ) -> Result:
        """Solve each row by itself on all atoms; in `FIRST_PASSES` passes if it may be `brief`."""
        problem = self._problem(samples, FIRST_REGULARIZATION * self.level)
        passes = self.solver.max_passes
        solver = replace(
            self.solver,
            tolerance=max(FIRST_TOLERANCE, self.solver.tolerance),
            max_passes=min(FIRST_PASSES, passes) if brief else passes,
        )
        return solver.solve(problem, progress)

    def unexplained(self, samples: Samples, solved: Result, share: float) -> NDArray[np.int64]:
        """Rows whose samples the solution does not explain, but other atoms might.

        Their objective exceeds a share of what an even background leaves of their samples, beside
        the penalty that they would pay if a single pixel explained everything. Without it, all
        dark rows would search.
        """
        weights = samples.weights_of_all().astype(np.float64)
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
        means = (weights * samples.values).sum(axis=1, keepdims=True) / total
        left = (weights * (samples.values - means) ** 2).sum(axis=1)
        # No atom can enter darker rows than this, if they search all atoms.
        column = self.atoms.single_contrast * np.sqrt(self.capture.count)
        bright = np.sqrt(left) * LONGEST * column > FIRST_REGULARIZATION * self.level
        penalty = self.penalty * np.sqrt(left) / column
        wrong = solved.rows.diagnostics["objective"] > share * left / 2 + penalty
        return np.flatnonzero(bright & wrong)

    def weighted_rows(
        self,
        samples: Samples,
        rows: NDArray[np.int64],
        this_round: Round,
        neighbours: Neighbourhood,
    ) -> WeightedRows:
        """The problem of some rows, ascending, with what their neighbours say of them."""
        assert this_round.window is not None
        problem = self._problem(samples, self.penalty)
        first, last = int(rows[0]), int(rows[-1]) + 1
        if this_round.has_pseudo_samples:
            first, last = neighbours.around(first, last)
        halos = self.halos(neighbours, first, last)
        pseudo_samples = None
        if this_round.has_pseudo_samples:
            light = neighbours.rows.background[first:last]
            pseudo_samples = neighbours.pseudo_samples(
                self.unseen,
                samples,
                samples.clipped & Fidelity(self.solver.fidelity).term.clip_aware,
                self.capture.reference_level,
                rows,
                light * halos,
            )
        unseen = pseudo_samples is not None
        cells = Cells.none(self.capture.patterns, self.unseen if unseen else None)
        # Cells join in the last round, when it is clear where most of the light is.
        if this_round.last:
            cost = self.level / problem.regularization
            cells = self.backgrounds.cells(cost, unseen=unseen)
        background = halos[rows - first, : cells.means.shape[1]]
        known = samples.counted & ~samples.clipped
        candidates = neighbours.likely_atoms(
            this_round.window,
            self.candidates,
            self.trust,
            known.sum(axis=1),
            rows,
            first=this_round.age == 1,
        )
        return WeightedRows(
            problem, candidates, cells, pseudo_samples, np.ascontiguousarray(background)
        )

    def near(
        self,
        samples: Samples,
        rows: NDArray[np.int64],
        this_round: Round,
        neighbours: Neighbourhood,
        progress: Progress | None = None,
    ) -> tuple[Result, WeightedRows]:
        """Solve rows, ascending, on their likeliest atoms; returns their problem too."""
        weighted = self.weighted_rows(samples, rows, this_round, neighbours)
        solved = solve_weighted(
            weighted.problem,
            weighted.candidates,
            weighted.cells,
            self.solver,
            pseudo_samples=weighted.pseudo_samples,
            background=weighted.background,
            start=neighbours.rows.rows(rows),
            progress=progress,
        )
        return solved, weighted

    def halos(self, neighbours: Neighbourhood, start: int, stop: int) -> NDArray[np.float32]:
        """The halos of the rows start..stop under the patterns shown and unseen, (n, K + E)."""
        backgrounds = self.backgrounds
        centres = csr_array(neighbours.centres[start:stop])
        return backgrounds.under_patterns(backgrounds.spread(centres))

    def _problem(self, samples: Samples, penalty: float) -> Problem:
        """The problem of rows of atoms, for a penalty of single pixels."""
        return Problem(self.atoms, samples, penalty * self.atoms.gains[0])
