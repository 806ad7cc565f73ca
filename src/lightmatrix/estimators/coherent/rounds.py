"""The rounds of the coherent estimate: each solves rows with what the last one found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
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
from lightmatrix.estimators.join import TILE_BYTES, kept
from lightmatrix.estimators.steps import Found, Progress, SolveTile, cut
from lightmatrix.solvers.problem import Result
from lightmatrix.store import ROWS
from lightmatrix.store.tiles import Span
from lightmatrix.transport.sparse_rows import SparseRows, footprint_sizes

# Of each row of a large frame: whether it looked at every projector pixel; and, of some rows,
# whether none beside its likeliest would enter it, NaN of the others.
LOOKED, HOLDS = "looked_everywhere", "holds_everywhere"
# The step, and the fact of its rows, that measures the misfit under the frames held out.
HELD_OUT = "held-out"


@dataclass(frozen=True)
class Rounds:
    """The stages of an estimate; see `CoherentEstimator`.

    Parameters
    ----------
    solving : Solving
        How rows are solved.
    stages : tuple of Stage
        All rounds in turn.
    tile_rows : int or None
        Rows solved at a time. None: as many as fit half a gigabyte.
    progress : callable or None
        Called with (done, total) rows.
    """

    solving: Solving
    stages: tuple[Stage, ...]
    tile_rows: int | None
    progress: Progress | None
    _latest: dict[int, Neighbourhood] = field(default_factory=dict, init=False, repr=False)

    @property
    def capture(self) -> Capture:
        """What is estimated from."""
        return self.solving.capture

    @property
    def steps(self) -> Mapping[str, tuple[str, ...]]:
        """A step a round; the last one is solved twice, first without the frames held out."""
        names = [round_name(number) for number in range(len(self.stages) - 1)]
        rounds = {name: (before,) for before, name in pairwise(names)}
        return {names[0]: (), **rounds, HELD_OUT: (names[-1],), ROWS: (names[-1], HELD_OUT)}

    def begin(self, step: str, found: Found) -> SolveTile:
        """What the rows of a step know of the one before, and what solves some of them."""
        number = self._number(step)
        if number == 0:
            return self._first
        known = self._known(number, found)
        if step == HELD_OUT:
            return partial(self._misfit, known)
        if step != ROWS:
            return partial(self._again, number, known)
        misfit = found(HELD_OUT).diagnostics[HELD_OUT]
        if len(held_out_frames(self.capture.count)):
            misfit = pooled(misfit, known.camera)
        return partial(self._last, known, misfit)

    def ranges(self, step: str, parts: int = 1, *, shrinking: bool = False) -> Iterator[Span]:
        """Rows of a step that are solved at a time."""
        solving = self.solving
        row_bytes = coherent_row_bytes(solving.capture.count, solving.candidates)
        most = self.tile_rows or max(1, TILE_BYTES // row_bytes)
        return cut(self._grid(self.stages[self._number(step)]).count, most, parts, shrinking)

    def report(self, step: str, start: int = 0) -> Progress | None:
        """Tells rows as if all took alike: each round counts by the time that it usually takes."""
        report = self.progress
        if report is None:
            return None
        rows, costs = self.capture.rows, self._costs
        number = len(self.stages) if step == ROWS else self._number(step)
        before, cost = sum(costs[:number]) / sum(costs), costs[number] / sum(costs)
        count = self._grid(self.stages[self._number(step)]).count
        return lambda done, _: report(int(rows * (before + cost * (start + done) / count)), rows)

    def silent(self) -> Rounds:
        """The same without anybody who listens."""
        return replace(self, progress=None)

    def _number(self, step: str) -> int:
        """Which of the stages a step is."""
        last = len(self.stages) - 1
        return last if step in (HELD_OUT, ROWS) else [*self.steps].index(step)

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

    def _first(self, start: int, stop: int) -> SparseRows:
        samples = self._grid(self.stages[0]).samples(start, stop)
        solved = self.solving.everywhere(samples, self.report(round_name(0), start))
        return _looked(solved) if self._grown else _found(solved)

    def _again(self, number: int, known: Neighbourhood, start: int, stop: int) -> SparseRows:
        """The rows start..stop of a round, with what neighbours found in the one before."""
        stage = self.stages[number]
        samples = self._grid(stage).samples(start, stop)
        rows, report = np.arange(start, stop), self.report(round_name(number), start)
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

    def _misfit(self, known: Neighbourhood, start: int, stop: int) -> SparseRows:
        """Squared errors of the rows start..stop under frames that are held out of the last round.

        As facts of rows without light.
        """
        count = stop - start
        nothing = csr_array((count, self.solving.atoms.pixels), dtype=np.float32)
        facts = {HELD_OUT: self._squares(known, start, stop)}
        return SparseRows(nothing, np.zeros((count, 1), np.float32), facts)

    def _squares(self, known: Neighbourhood, start: int, stop: int) -> NDArray[np.float32]:
        solving, stage = self.solving, self.stages[-1]
        held = held_out_frames(solving.capture.count)
        if not len(held):
            return np.full(stop - start, np.nan, np.float32)
        samples = solving.capture.samples(start, stop)
        part, report = without(samples, held), self.report(HELD_OUT, start)
        solved, weighing = solving.near(part, np.arange(start, stop), stage, known, report)
        light = solved.background[:, None] * weighing.background[:, held]
        if solved.cells.shape[1]:
            light += solved.cells @ solving.backgrounds.shown_means[:, held]
        predicted = solved.coefficients @ self._held_atoms + light
        return squared_misfit(samples, predicted.astype(np.float32), held)

    @cached_property
    def _held_atoms(self) -> NDArray[np.float32]:
        """The atoms under the frames held out, (S N, H)."""
        atoms = self.solving.atoms
        held = held_out_frames(self.capture.count)
        return np.stack([atoms.rows(k, k + 1)[0] for k in held], axis=1)

    def _last(
        self, known: Neighbourhood, misfit: NDArray[np.float32], start: int, stop: int
    ) -> SparseRows:
        """The rows start..stop of the last round, with the light of each cell."""
        solving, stage = self.solving, self.stages[-1]
        samples = solving.capture.samples(start, stop)
        report = self.report(ROWS, start)
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

    def _known(self, number: int, found: Found) -> Neighbourhood:
        """What a round knows of all its rows, from what the one before found."""
        # The last round is solved twice with it.
        if number not in self._latest:
            self._latest.clear()
            self._latest[number] = self._neighbourhood(number, found(round_name(number - 1)))
        return self._latest[number]

    def _neighbourhood(self, number: int, found: SparseRows) -> Neighbourhood:
        grid, before = self._grid(self.stages[number]), self._grid(self.stages[number - 1])
        atoms = self.solving.atoms
        known = Neighbourhood(found, before.camera, atoms, before.spacing)
        if grid is before:
            return known
        grown, moved = grid.grown(before, found), grid.movement(before, known.movement)
        return Neighbourhood(grown, grid.camera, atoms, grid.spacing, moved)

    @cached_property
    def _costs(self) -> list[float]:
        """What each round costs, and the last one twice, in rows that look at few atoms."""
        capture = self.solving.capture
        patterns = capture.patterns
        grey = patterns.as_bits() is None
        everywhere = first_round_cost(capture.rows, patterns.pixels, patterns.count, grey)
        costs = [
            self._grid(stage).count * (everywhere if stage.window is None else 1.0)
            for stage in self.stages
        ]
        return [*costs, costs[-1]]


def round_name(number: int) -> str:
    """The step of a round."""
    return f"round-{number}"


def _found(solved: Result, before: SparseRows | None = None) -> SparseRows:
    """What the next round asks of this one, with what was known of the same rows before."""
    facts = {} if before is None else before.diagnostics
    return replace(solved.rows.single(), diagnostics=facts)


def _looked(solved: Result) -> SparseRows:
    """The same of rows of large frames that looked everywhere."""
    ones = np.ones(solved.rows.count, np.float32)
    return replace(solved.rows.single(), diagnostics={LOOKED: ones, CHANGE: ones})
