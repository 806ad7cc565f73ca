"""The rounds of the coherent estimate: each solves rows with what the last one found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.certificate import holds_everywhere, sampled
from lightmatrix.estimators.coherent.grid import CameraGrid
from lightmatrix.estimators.coherent.held_out import (
    held_out_frames,
    pooled,
    squared_misfit,
    without,
)
from lightmatrix.estimators.coherent.neighbourhood import Neighbourhood
from lightmatrix.estimators.coherent.settling import (
    CHANGE,
    as_they_were,
    replaced,
    unsettled,
    with_change,
)
from lightmatrix.estimators.coherent.solving import Solving
from lightmatrix.estimators.coherent.stages import Stage
from lightmatrix.estimators.costs import coherent_row_bytes, first_round_cost
from lightmatrix.estimators.join import TILE_BYTES, Progress, SolveTile, kept
from lightmatrix.solvers.problem import Result
from lightmatrix.store import Checkpoint
from lightmatrix.transport.footprints import footprint_sizes
from lightmatrix.transport.sparse_rows import SparseRows

# Of each row of a large frame: whether it looked at every projector pixel; and, of some rows,
# whether none beside its likeliest would enter it, NaN of the others.
LOOKED, HOLDS = "looked_everywhere", "holds_everywhere"
# What a checkpoint calls the misfit under the frames held out.
HELD_OUT = "held-out"


@dataclass(frozen=True)
class Rounds:
    """The stages of an estimate; see `CoherentEstimator`.

    Parameters
    ----------
    solving : Solving
        How rows are solved.
    stages : tuple of Stage
        All rounds in turn; the last one is solved by tiles that the caller keeps.
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte.
    progress : callable or None
        Called with (done, total) rows.
    """

    solving: Solving
    stages: tuple[Stage, ...]
    tile_rows: int | None
    progress: Progress | None

    def begin(self, running: Checkpoint | None) -> SolveTile:
        """All rounds but the last, whose tiles the result solves."""
        known = self._known(len(self.stages) - 1, self._before_last(running))
        misfit = self._recalled_misfit(running)
        if misfit is None:
            misfit = self._misfit(known)
            if running is not None:
                running.remember(HELD_OUT, self._facts(misfit))
        return partial(self._last, known, misfit)

    def ranges(self, stage: Stage | None = None) -> Iterator[tuple[int, int]]:
        """Rows of a stage that are solved at a time; None is the last."""
        solving = self.solving
        row_bytes = coherent_row_bytes(solving.capture.count, solving.candidates)
        tile = self.tile_rows or max(1, TILE_BYTES // row_bytes)
        count = self._grid(stage or self.stages[-1]).count
        for start in range(0, count, tile):
            yield start, min(start + tile, count)

    @property
    def _grown(self) -> bool:
        """Whether light grows from seeds, as in large frames."""
        return self.stages[0].spacing > 1

    @cached_property
    def _grids(self) -> dict[int, CameraGrid]:
        steps = {stage.spacing for stage in self.stages}
        return {spacing: CameraGrid(self.solving.capture, spacing) for spacing in steps}

    def _grid(self, stage: Stage) -> CameraGrid:
        return self._grids[stage.spacing]

    def _before_last(self, running: Checkpoint | None) -> SparseRows:
        """What the rounds before the last one find, from where a checkpoint has come to."""
        latest, found = self._latest(running)
        for number in range(latest + 1, len(self.stages) - 1):
            known = self._known(number, found)
            found = self._whole(running, number, partial(self._again, number, known))
        return found

    def _latest(self, running: Checkpoint | None) -> tuple[int, SparseRows]:
        """The latest round that was finished, and what it found."""
        if running is not None:
            for number in reversed(range(len(self.stages) - 1)):
                if (found := self._recalled(running, number)) is not None:
                    return number, found
        return 0, self._whole(running, 0, self._first)

    def _recalled(self, running: Checkpoint, number: int) -> SparseRows | None:
        """What a checkpoint remembers of a round; None if nothing whole."""
        if (found := running.recall(f"round-{number}")) is None:
            return None
        shape = (self._grid(self.stages[number]).count, self.solving.atoms.pixels)
        fits = found.coefficients.shape == shape and found.background.shape[1] == 1
        return found if fits and (LOOKED in found.diagnostics) == self._grown else None

    def _whole(self, running: Checkpoint | None, number: int, solve: SolveTile) -> SparseRows:
        """A round over all its rows; the checkpoint remembers it instead of the one before."""
        stage = self.stages[number]
        found = SparseRows.joined([solve(start, stop) for start, stop in self.ranges(stage)])
        if running is not None:
            running.remember(f"round-{number}", found)
            running.forget(f"round-{number - 1}")
        return found

    def _first(self, start: int, stop: int) -> SparseRows:
        samples = self._grid(self.stages[0]).samples(start, stop)
        solved = self.solving.everywhere(samples, self._report(0, start))
        return _looked(solved) if self._grown else _found(solved)

    def _again(self, number: int, known: Neighbourhood, start: int, stop: int) -> SparseRows:
        """The rows start..stop of a round, with what neighbours found in the one before."""
        stage = self.stages[number]
        samples = self._grid(stage).samples(start, stop)
        rows, report = np.arange(start, stop), self._report(number, start)
        if not self._grown:
            return _found(self.solving.near(samples, rows, stage, known, report)[0])
        before = known.rows.rows(rows)
        if not stage.still:
            solved, _ = self.solving.near(samples, rows, stage, known, report)
            found = _found(solved, before)
            if stage.again:
                found = self._explained(samples, solved, found)
            return with_change(found, before)
        moving = np.flatnonzero(unsettled(known.rows, known.camera)[start:stop])
        if not len(moving):
            return as_they_were(before)
        some = before.rows(moving)
        solved, _ = self.solving.near(samples.rows(moving), rows[moving], stage, known, report)
        return replaced(before, with_change(_found(solved, some), some), moving)

    def _explained(self, samples: Samples, solved: Result, found: SparseRows) -> SparseRows:
        """Rows as they were found; those that are not explained look everywhere."""
        odd = self.solving.unexplained(samples, solved)
        if not len(odd):
            return found
        again = _looked(self.solving.everywhere(samples.rows(odd)))
        lit = np.flatnonzero(np.diff(again.coefficients.indptr) > 0)
        return replaced(found, again.rows(lit), odd[lit]) if len(lit) else found

    def _recalled_misfit(self, running: Checkpoint | None) -> NDArray[np.float32] | None:
        """What a checkpoint remembers of `_misfit`; None if nothing whole."""
        if running is None or (found := running.recall(HELD_OUT)) is None:
            return None
        misfit = found.diagnostics.get(HELD_OUT)
        if misfit is None or misfit.dtype != np.float32:
            return None
        return misfit if len(misfit) == self.solving.capture.rows else None

    def _facts(self, misfit: NDArray[np.float32]) -> SparseRows:
        """Facts of all rows as a checkpoint keeps them: of rows without light."""
        count = len(misfit)
        nothing = csr_array((count, self.solving.atoms.pixels), dtype=np.float32)
        return SparseRows(nothing, np.zeros((count, 1), np.float32), {HELD_OUT: misfit})

    def _misfit(self, known: Neighbourhood) -> NDArray[np.float32]:
        """Squared errors of all rows under frames that are held out of the last round, (M,)."""
        solving, stage = self.solving, self.stages[-1]
        held = held_out_frames(solving.capture.count)
        if not len(held):
            return np.full(solving.capture.rows, np.nan, np.float32)
        shown = np.concatenate([solving.atoms.rows(k, k + 1) for k in held])
        parts = []
        for start, stop in self.ranges():
            samples = solving.capture.samples(start, stop)
            report = self._report(len(self.stages) - 1, start)
            part = without(samples, held)
            solved, _ = solving.near(part, np.arange(start, stop), stage, known, report)
            halos = solving.halos(known, slice(start, stop))[:, held]
            light = solved.background[:, None] * halos
            if solved.cells.shape[1]:
                light += solved.cells @ solving.backgrounds.shown_means[:, held]
            predicted = solved.coefficients @ shown.T + light
            parts.append(squared_misfit(samples, predicted.astype(np.float32), held))
        return pooled(np.concatenate(parts), known.camera)

    def _last(
        self, known: Neighbourhood, misfit: NDArray[np.float32], start: int, stop: int
    ) -> SparseRows:
        """The rows start..stop of the last round, with the light of each cell."""
        solving, stage = self.solving, self.stages[-1]
        samples = solving.capture.samples(start, stop)
        # The last round is solved twice: first without the frames held out.
        report = self._report(len(self.stages), start)
        rows = np.arange(start, stop)
        solved, weighing = solving.near(samples, rows, stage, known, report)
        shares = solving.backgrounds.spread(known.centres[start:stop])
        background = solved.background[:, None] * shares
        if solved.cells.shape[1]:
            background += solved.cells
        found = kept(samples, solved)
        whole = replace(
            found,
            coefficients=solving.atoms.expand(found.coefficients),
            background=background.astype(np.float32),
        )
        length = solving.backgrounds.lengths(whole)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt(misfit[start:stop]) / (solving.atoms.single_contrast * length)
        told: dict[str, NDArray[Any]] = {
            "footprint": footprint_sizes(whole.coefficients),
            "estimated_error": error,
        }
        if self._grown:
            some = sampled(start, stop, known.rows.count) - start
            holds = np.full(stop - start, np.nan)
            holds[some] = holds_everywhere(solving, weighing, solved, some)
            told |= {LOOKED: known.rows.diagnostics[LOOKED][start:stop], HOLDS: holds}
        facts = {name: values.astype(np.float32) for name, values in told.items()}
        return replace(whole, diagnostics=dict(whole.diagnostics) | facts)

    def _known(self, number: int, found: SparseRows) -> Neighbourhood:
        """What a round knows of all its rows, from what the one before found."""
        grid, before = self._grid(self.stages[number]), self._grid(self.stages[number - 1])
        atoms = self.solving.atoms
        known = Neighbourhood(found, before.camera, atoms, before.spacing)
        if grid is before:
            return known
        grown, moved = grid.grown(before, found), grid.movement(before, known.movement)
        return Neighbourhood(grown, grid.camera, atoms, grid.spacing, moved)

    def _report(self, number: int, start: int) -> Progress | None:
        """Tells rows as if all took alike: each round counts by the time that it usually takes."""
        report = self.progress
        if report is None:
            return None
        rows, costs = self.solving.capture.rows, self._costs
        before, cost = sum(costs[:number]) / sum(costs), costs[number] / sum(costs)
        count = self._grid(self.stages[min(number, len(self.stages) - 1)]).count
        return lambda done, _: report(int(rows * (before + cost * (start + done) / count)), rows)

    @cached_property
    def _costs(self) -> list[float]:
        """What each round costs, and the last one twice, in rows that look at few atoms."""
        capture = self.solving.capture
        patterns = capture.patterns
        grey = patterns.packed_bits() is None
        everywhere = first_round_cost(capture.rows, patterns.pixels, patterns.count, grey)
        costs = [
            self._grid(stage).count * (everywhere if stage.window is None else 1.0)
            for stage in self.stages
        ]
        return [*costs, costs[-1]]


def _found(solved: Result, before: SparseRows | None = None) -> SparseRows:
    """What the next round asks of this one, with what was known of the same rows before."""
    facts = {} if before is None else before.diagnostics
    return replace(solved.rows.single(), diagnostics=facts)


def _looked(solved: Result) -> SparseRows:
    """The same of rows of large frames that looked everywhere."""
    ones = np.ones(solved.rows.count, np.float32)
    return replace(solved.rows.single(), diagnostics={LOOKED: ones, CHANGE: ones})
