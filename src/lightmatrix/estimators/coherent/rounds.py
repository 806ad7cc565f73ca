"""The rounds of the coherent estimate: each solves every row with what the last one found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.backgrounds import Backgrounds
from lightmatrix.estimators.coherent.held_out import (
    held_out_frames,
    pooled,
    squared_misfit,
    without,
)
from lightmatrix.estimators.coherent.neighbourhood import Neighbourhood, unseen_patterns
from lightmatrix.estimators.join import TILE_BYTES, Progress, SolveTile, kept
from lightmatrix.estimators.needs import coherent_row_bytes, first_round_share
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.solvers.weighted import Cells, Expectation, solve_weighted
from lightmatrix.store import Checkpoint
from lightmatrix.transport.footprints import footprint_sizes
from lightmatrix.transport.sparse_rows import SparseRows

# Of the clip level.
DEFAULT_REGULARIZATION = 0.1
# Of the clip level, and the gap: the first estimate, row by row, only has to show where light is.
FIRST_REGULARIZATION = 0.32
FIRST_TOLERANCE = 1e-2
# What neighbours' rows give is expected from this round on: then most rows are about right.
EXPECTING = 3
# Regularizations are for patterns of this contrast, the standard deviation of their values, which
# random patterns have half of whose pixels are lit; for others they change in proportion.
USUAL_CONTRAST = 0.5
# Spots are no wider than this share of the projector's shorter side.
WIDEST = 1 / 16


@dataclass(frozen=True)
class Rounds:
    """See `CoherentEstimator`, whose parameters these are."""

    capture: Capture
    solver: ActiveSet
    regularization: float | None
    trust: float
    windows: tuple[tuple[int, int], ...]
    candidates: int
    sizes: tuple[float, ...]
    background_grid: tuple[int, int]
    tile_rows: int | None
    progress: Progress | None

    def begin(self, running: Checkpoint | None) -> SolveTile:
        """All rounds but the last, whose tiles the result solves."""
        known = self._neighbourhood(self._before_last(running))
        return partial(self._last, known, self._misfit(known))

    @cached_property
    def atoms(self) -> AtomPatterns:
        """What pixels and spots give under the patterns shown."""
        patterns = self.capture.patterns
        widest = WIDEST * min(patterns.shape)
        return AtomPatterns(patterns, tuple(size for size in self.sizes if size <= widest))

    @cached_property
    def unseen(self) -> AtomPatterns:
        """What they give under patterns that nobody shows."""
        atoms = self.atoms
        return AtomPatterns(unseen_patterns(atoms.shape), atoms.sizes, atoms.gains)

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

    def ranges(self) -> Iterator[tuple[int, int]]:
        """Rows solved at a time."""
        row_bytes = coherent_row_bytes(self.capture.count, self.candidates)
        tile = self.tile_rows or max(1, TILE_BYTES // row_bytes)
        for start in range(0, self.capture.rows, tile):
            yield start, min(start + tile, self.capture.rows)

    def _before_last(self, running: Checkpoint | None) -> SparseRows:
        """What the rounds before the last one find, from where a checkpoint has come to."""
        latest, found = self._latest(running)
        for number in range(latest + 1, len(self.windows)):
            known = self._neighbourhood(found)
            found = self._whole(running, number, partial(self._again, number, known))
        return found

    def _latest(self, running: Checkpoint | None) -> tuple[int, SparseRows]:
        """The latest round that was finished, and what it found."""
        if running is not None:
            for number in reversed(range(len(self.windows))):
                if (found := self._recalled(running, number)) is not None:
                    return number, found
        return 0, self._whole(running, 0, self._first)

    def _recalled(self, running: Checkpoint, number: int) -> SparseRows | None:
        """What a checkpoint remembers of a round; None if nothing whole."""
        if (found := running.recall(f"round-{number}")) is None:
            return None
        shape = (self.capture.rows, self.atoms.pixels)
        fits = found.coefficients.shape == shape and found.background.shape[1] == 1
        return found if fits else None

    def _whole(self, running: Checkpoint | None, number: int, solve: SolveTile) -> SparseRows:
        """A round over all rows; the checkpoint remembers it instead of the one before."""
        found = SparseRows.joined([solve(start, stop) for start, stop in self.ranges()])
        if running is not None:
            running.remember(f"round-{number}", found)
            running.forget(f"round-{number - 1}")
        return found

    def _first(self, start: int, stop: int) -> SparseRows:
        samples = self.capture.samples(start, stop)
        problem = self._problem(samples, FIRST_REGULARIZATION * self.level)
        solver = replace(self.solver, tolerance=max(FIRST_TOLERANCE, self.solver.tolerance))
        return _found(solver.solve(problem, self._report(0, start)))

    def _again(self, number: int, known: Neighbourhood, start: int, stop: int) -> SparseRows:
        samples = self.capture.samples(start, stop)
        return _found(self._solve(samples, start, stop, number, known))

    def _misfit(self, known: Neighbourhood) -> NDArray[np.float32]:
        """Squared errors of all rows under frames that are held out of the last round, (M,)."""
        held = held_out_frames(self.capture.count)
        if not len(held):
            return np.full(self.capture.rows, np.nan, np.float32)
        shown = np.concatenate([self.atoms.rows(k, k + 1) for k in held])
        parts = []
        for start, stop in self.ranges():
            samples = self.capture.samples(start, stop)
            solved = self._solve(without(samples, held), start, stop, len(self.windows), known)
            light = solved.background[:, None] * self._halos(known, start, stop)[:, held]
            if solved.cells.shape[1]:
                light += solved.cells @ self.backgrounds.shown_means[:, held]
            predicted = solved.coefficients @ shown.T + light
            parts.append(squared_misfit(samples, predicted.astype(np.float32), held))
        return pooled(np.concatenate(parts), known.camera)

    def _last(
        self, known: Neighbourhood, misfit: NDArray[np.float32], start: int, stop: int
    ) -> SparseRows:
        """The rows start..stop of the last round, with the light of each cell."""
        samples = self.capture.samples(start, stop)
        solved = self._solve(samples, start, stop, len(self.windows), known, settled=True)
        shares = self.backgrounds.spread(known.centres[start:stop])
        background = solved.background[:, None] * shares
        if solved.cells.shape[1]:
            background += solved.cells
        found = kept(samples, solved)
        whole = replace(
            found,
            coefficients=self.atoms.expand(found.coefficients),
            background=background.astype(np.float32),
        )
        length = self.backgrounds.lengths(whole)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt(misfit[start:stop]) / (self.atoms.single_contrast * length)
        told = {"footprint": footprint_sizes(whole.coefficients), "estimated_error": error}
        facts = {name: values.astype(np.float32) for name, values in told.items()}
        return replace(whole, diagnostics=dict(whole.diagnostics) | facts)

    def _solve(
        self,
        samples: Samples,
        start: int,
        stop: int,
        number: int,
        known: Neighbourhood,
        *,
        settled: bool = False,
    ) -> Result:
        """The rows start..stop, with penalties from what was found before."""
        problem = self._problem(samples, self.penalty)
        found = known.rows
        expected = None
        if number >= EXPECTING:
            expected = self._expected(samples, start, stop, known)
        unseen = expected is not None
        cells = Cells.none(self.capture.patterns, self.unseen if unseen else None)
        # Cells join in the last round, when it is clear where most of the light is.
        if number == len(self.windows):
            cost = self.level / problem.regularization
            cells = self.backgrounds.cells(cost, unseen=unseen)
        background = self._halos(known, start, stop)[:, : cells.means.shape[1]]
        return solve_weighted(
            problem,
            known.likely(
                self.windows[number - 1],
                self.candidates,
                self.trust,
                (start, stop),
                first=number == 1,
            ),
            cells,
            self.solver,
            expected=expected,
            background=np.ascontiguousarray(background),
            start=found.rows(slice(start, stop)),
            # The last round is solved twice: first without the frames held out.
            progress=self._report(number + settled, start),
        )

    def _neighbourhood(self, found: SparseRows) -> Neighbourhood:
        """What a round knows of all rows."""
        rows, cols, *channels = self.capture.camera_shape
        camera = (rows, cols, channels[0] if channels else 1)
        return Neighbourhood(found, camera, self.atoms)

    def _expected(
        self, samples: Samples, start: int, stop: int, known: Neighbourhood
    ) -> Expectation:
        """What neighbours' rows, and their backgrounds, say of the samples of start..stop."""
        first, last = known.around(start, stop)
        background = known.rows.background[first:last] * self._halos(known, first, last)
        return known.expected(
            self.unseen,
            samples,
            samples.clipped & Fidelity(self.solver.fidelity).term.clip_aware,
            self.capture.reference_level,
            start,
            background,
        )

    def _halos(self, known: Neighbourhood, start: int, stop: int) -> NDArray[np.float32]:
        """What the backgrounds of the rows start..stop give under shown and unseen patterns."""
        backgrounds = self.backgrounds
        return backgrounds.under_patterns(backgrounds.spread(known.centres[start:stop]))

    def _problem(self, samples: Samples, penalty: float) -> Problem:
        """Rows of atoms, for a penalty of single pixels."""
        return Problem(self.atoms, samples, penalty * self.atoms.gains[0])

    def _report(self, number: int, start: int) -> Progress | None:
        """Tells rows as if all took alike: each round counts by the time that it usually takes."""
        report = self.progress
        if report is None:
            return None
        rows, first = self.capture.rows, self._first_share
        other = (1 - first) / (1 + len(self.windows))
        before, share = (0.0, first) if number == 0 else (first + (number - 1) * other, other)
        return lambda done, _: report(int(before * rows + share * (start + done)), rows)

    @cached_property
    def _first_share(self) -> float:
        """Of the time of all rounds, that of the first, which looks at every atom."""
        patterns = self.capture.patterns
        grey = patterns.packed_bits() is None
        return first_round_share(self.capture.rows, patterns.pixels, patterns.count, grey)


def _found(solved: Result) -> SparseRows:
    """What the next round asks of this one."""
    return replace(solved.rows.single(), diagnostics={})
