"""The coherent estimate as work: its rounds, each of which starts from the rows before it.

Where estimates spread from seeds, rows stay as they are if nothing changed around them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.base import rows_with_diagnostics
from lightmatrix.estimators.certainty import with_certainty
from lightmatrix.estimators.coherent.neighbourhood import REACH, CameraGrid, Neighbourhood
from lightmatrix.estimators.coherent.row_errors import (
    MOST_ROWS,
    HeldOut,
    held_out_energy,
    noise_of,
    predicted_samples,
    residual_diagnostics,
    smooth_misfit,
    squared_misfit,
    squared_residual,
    without,
)
from lightmatrix.estimators.coherent.row_solver import RowSolver, coherent_row_bytes, in_parts
from lightmatrix.estimators.coherent.schedule import GROWTH, Round
from lightmatrix.estimators.work import TILE_BYTES, ReadStep, SolveTile, Work, cut_rows
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.progress import Progress
from lightmatrix.resources.threads import computed_once, core_threads
from lightmatrix.solvers.problem import Result
from lightmatrix.transport.checkpoint import ROWS, Span
from lightmatrix.transport.sparse_rows import SparseRows, footprint_sizes

# The diagnostic that holds which share of its light changed in a row's last round.
CHANGE = "change"


def with_change(rows: SparseRows, before: SparseRows) -> SparseRows:
    """Rows with the share of their light that changed."""
    difference = np.asarray(abs(rows.coefficients - before.coefficients).sum(axis=1), np.float64)
    light = np.asarray(abs(rows.coefficients).sum(axis=1), np.float64)
    change = np.divide(difference, light, out=(difference > 0).astype(np.float64), where=light > 0)
    return replace(rows, diagnostics={**rows.diagnostics, CHANGE: change.astype(np.float32)})


def unsettled(rows: SparseRows, camera: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Which rows of a whole camera have a change around them, (M,)."""
    change = rows.diagnostics[CHANGE].reshape(camera)
    side = 2 * REACH + 1
    around = scipy.ndimage.maximum_filter(change, size=(side, side, 1), mode="nearest")
    # A row has settled if no row around it changed by more than this share of its light. Measured
    # on procedural scenes: after three rounds at a spacing a tenth to a quarter of the rows are
    # unsettled.
    return np.asarray(around > 0.02).ravel()


def unchanged(rows: SparseRows) -> SparseRows:
    """Rows that a round did not solve again."""
    return replace(rows, diagnostics={**rows.diagnostics, CHANGE: np.zeros(rows.count, np.float32)})


# The diagnostic where estimates spread from seeds: whether a row has searched all projector pixels.
SEARCHED = "searched_everywhere"
# The step that measures the misfit under the frames held out, and the diagnostic that holds it;
# and the diagnostic that holds the misfit of some rows under the other frames.
HELD_OUT, RESIDUAL = "held-out", "residual"
# Mean squares of a row's misses at these frames, and of its samples there.
_MISSED, _SEEN = "missed", "seen"


@dataclass(frozen=True)
class Rounds(Work):
    """The work of a `CoherentEstimator`."""

    solver: RowSolver
    rounds: tuple[Round, ...]
    tile_rows: int | None
    judged: bool
    _latest: dict[int, Neighbourhood] = field(default_factory=dict, init=False, repr=False)

    @property
    def capture(self) -> Capture:  # type: ignore[override]
        return self.solver.capture

    @property
    def steps(self) -> Mapping[str, tuple[str, ...]]:
        """One step for each round; of judged rows the last is solved without some frames first."""
        names = [round_name(number) for number in range(len(self.rounds) - 1)]
        rounds = {name: (before,) for before, name in pairwise(names)}
        steps = {names[0]: (), **rounds}
        if not self.judged:
            return steps | {ROWS: (names[-1],)}
        return steps | {HELD_OUT: (names[-1],), ROWS: (names[-1], HELD_OUT)}

    def tiles(self, step: str, parts: int = 1) -> Iterator[Span]:
        row_bytes = coherent_row_bytes(self.capture.count, self.solver.candidates)
        most = max(1, (self.tile_rows or TILE_BYTES // row_bytes) // self.together)
        # Rows are solved in parts, but unexplained ones of a tile search all parts together.
        most *= 8 if in_parts(self.capture) else 1
        return cut_rows(self._grid(self._number(step)).count, most, parts)

    def prepare(self, step: str, read: ReadStep) -> SolveTile:
        """Prepare the neighbourhood of a step, and return what solves its rows start..stop."""
        number = self._number(step)
        if number == 0:
            # In small frames spots of all sizes take little time, and blur is found more often.
            sought = self.solver.sought if self._grows else self.solver.atoms
            return partial(self._search, sought)
        neighbours = self._neighbours(number, read)
        if step == ROWS:
            # No later step has this neighbourhood.
            self._latest.clear()
        if step == HELD_OUT:
            return partial(self._hold_out, neighbours)
        if step != ROWS:
            return partial(self._solve, number, neighbours, self._chosen(number, neighbours))
        if not self.judged:
            return partial(self._judge, neighbours, None, None)
        before = read(HELD_OUT).diagnostics
        misfit = before[HELD_OUT]
        with np.errstate(divide="ignore", invalid="ignore"):
            missed = np.sqrt(before[_MISSED] / _mean(before[_SEEN]))
        if len(self._held_out.frames):
            noise = noise_of(before[RESIDUAL])
            misfit = smooth_misfit(misfit, neighbours.camera, noise, self._tested_every)
        return partial(self._judge, neighbours, misfit, missed)

    @property
    def together(self) -> int:
        """Two if the core has several threads: Python prepares one while it solves the other."""
        return 2 if (self.solver.solver.threads or core_threads()) > 1 else 1

    def solved(self, step: str, done: int) -> int:
        """Each round counts by its usual time."""
        number = len(self.rounds) if step == ROWS else self._number(step)
        before, cost = sum(self._costs[:number]), self._costs[number]
        share = done / self._grid(self._number(step)).count
        return int(self.capture.rows * (before + cost * share) / sum(self._costs))

    def _number(self, step: str) -> int:
        last = len(self.rounds) - 1
        return last if step in (HELD_OUT, ROWS) else [*self.steps].index(step)

    @property
    def _grows(self) -> bool:
        """Whether estimates spread from seeds, as in all but small frames."""
        return self.rounds[0].spacing > 1

    @computed_once
    def _grids(self) -> dict[int, CameraGrid]:
        spacings = {step.spacing for step in self.rounds}
        return {spacing: CameraGrid(self.capture, spacing) for spacing in spacings}

    def _grid(self, number: int) -> CameraGrid:
        return self._grids[self.rounds[number].spacing]

    def _search(
        self, sought: AtomPatterns, start: int, stop: int, progress: Progress
    ) -> SparseRows:
        """The rows start..stop of the first round, each by itself, on the atoms sought."""
        samples = self._grid(0).samples(start, stop)
        solved = self.solver.everywhere(samples, sought, progress)
        return _searched(solved) if self._grows else _for_next_round(solved)

    def _chosen(self, number: int, neighbours: Neighbourhood) -> NDArray[np.bool_] | None:
        """The rows that a round solves, (M,); None: all of them."""
        this_round, camera = self.rounds[number], neighbours.camera
        if self._grows and this_round.skip_settled:
            return unsettled(neighbours.rows, camera)
        if this_round.skip_every_second:
            row, col, _ = np.indices(camera, sparse=True)
            return np.broadcast_to((row + col) % 2 == 0, camera).ravel()
        return None

    def _solve(
        self, number: int, neighbours: Neighbourhood, chosen: NDArray[np.bool_] | None,
        start: int, stop: int, progress: Progress,
    ) -> SparseRows:  # fmt: skip
        """The rows start..stop of a round, of which only the `chosen` ones are solved, (M,)."""
        this_round = self.rounds[number]
        samples = self._grid(number).samples(start, stop)
        rows = np.arange(start, stop)
        if not self._grows:
            solved, _ = self.solver.near(samples, rows, this_round, neighbours, progress)
            return _for_next_round(solved)
        before = neighbours.rows.rows(rows)
        if chosen is None:
            solved, _ = self.solver.near(samples, rows, this_round, neighbours, progress)
            result = _for_next_round(solved, before)
            if this_round.search_unexplained:
                share = this_round.search_unexplained
                result = self._search_unexplained(
                    samples, solved, result, share, neighbours, start, progress
                )
            return with_change(result, before)
        some = np.flatnonzero(chosen[start:stop])
        if not len(some):
            return unchanged(before)
        part = before.rows(some)
        solved, _ = self.solver.near(
            samples.rows(some), rows[some], this_round, neighbours, progress
        )
        new = with_change(_for_next_round(solved, part), part)
        return unchanged(before).replaced(some, new)

    def _search_unexplained(
        self, samples: Samples, solved: Result, rows: SparseRows, share: float,
        neighbours: Neighbourhood, start: int, progress: Progress,
    ) -> SparseRows:  # fmt: skip
        """Rows of which those that leave more than a share unexplained have searched for light."""
        unexplained = self.solver.unexplained(samples, solved, share)
        if not len(unexplained):
            return rows

        solved = self.solver.everywhere(
            samples.rows(unexplained), self.solver.atoms,
            lambda *_: progress(rows.count, rows.count),
            self.solver.squares_seen(start + unexplained, neighbours),
        )  # fmt: skip
        again = _searched(solved)
        lit = np.flatnonzero(np.diff(again.coefficients.indptr) > 0)
        return unchanged(rows).replaced(unexplained[lit], again.rows(lit)) if len(lit) else rows

    def _hold_out(
        self, neighbours: Neighbourhood, start: int, stop: int, progress: Progress
    ) -> SparseRows:
        """Misfits of rows at the frames held out, and of some of them at the other frames."""
        solver, held = self.solver, self._held_out.judged
        names = (HELD_OUT, RESIDUAL, _MISSED, _SEEN)
        known = {name: np.full(stop - start, np.nan, np.float32) for name in names}
        misfits, residuals, missed, seen = known.values()
        rows = self._every(self._tested_every, start, stop)
        if len(held) and len(rows):
            samples = self.capture.samples(start, stop).rows(rows - start)
            predicted = np.empty((len(rows), len(held)), np.float32)
            for frames, places in self._held_out.together(self.capture.count):
                kept = without(samples, frames)
                solved, background = solver.near(kept, rows, self.rounds[-1], neighbours, progress)
                shown = predicted_samples(solver, background, solved, np.arange(len(rows)))
                predicted[:, places] = (shown.atoms + shown.background)[:, held[places]]
            misfits[rows - start] = squared_misfit(samples, predicted, held)
            missed[rows - start], seen[rows - start] = held_out_energy(samples, predicted, held)
            chosen = np.flatnonzero(np.isin(rows, self._every(self._looked_at, start, stop)))
            residuals[rows[chosen] - start] = squared_residual(kept, shown)[chosen]
        nothing = csr_array((stop - start, solver.atoms.pixels), dtype=np.float32)
        return SparseRows(nothing, np.zeros((stop - start, 1), np.float32), known)

    @property
    def _tested_every(self) -> int:
        """The spacing of the camera pixels that are solved without the frames held out."""
        if self.rounds[0].spacing <= GROWTH.near_seeds:
            return 1
        # In large frames only every second camera pixel along both axes is solved without the
        # frames held out, and every fourth one of cameras with at least this many pixels along
        # both. Errors are smooth over the camera, and all pixels would take a sixth of the time.
        return 4 if min(self.capture.camera_shape[:2]) >= 512 else 2

    @property
    def _looked_at(self) -> int:
        """The spacing of the camera pixels whose residuals are looked at, a power of two."""
        spacing = self._tested_every
        while self.capture.rows > MOST_ROWS * spacing**2:
            spacing *= 2
        return spacing

    def _every(self, spacing: int, start: int, stop: int) -> NDArray[np.int64]:
        """The rows start..stop of every so many camera pixels along both axes."""
        rows = np.arange(start, stop)
        _, cols, channels = self._grid(len(self.rounds) - 1).camera
        row, col = np.divmod(rows // channels, cols)
        return rows[(row % spacing == 0) & (col % spacing == 0)]

    @computed_once
    def _held_out(self) -> HeldOut:
        return HeldOut.choose(self.capture.patterns)

    def _judge(
        self, neighbours: Neighbourhood, misfit: NDArray[np.float32] | None,
        missed: NDArray[np.float32] | None, start: int, stop: int, progress: Progress,
    ) -> SparseRows:  # fmt: skip
        """The rows start..stop of the result, in pixels, and with misfits how far to trust them."""
        solver, rows = self.solver, np.arange(start, stop)
        samples = self.capture.samples(start, stop)
        solved, background = solver.near(samples, rows, self.rounds[-1], neighbours, progress)
        centres = solver.atoms.centres(neighbours.rows.coefficients[start:stop])
        spread = solver.backgrounds.spread(centres)
        whole = solved.background[:, None] * spread
        if solved.cells.shape[1]:
            whole += solved.cells
        pixels = rows_with_diagnostics(samples, solved)
        expanded = solver.atoms.expand(pixels.coefficients)
        pixels = replace(pixels, coefficients=expanded, background=whole).rounded()
        if misfit is None or missed is None:
            return pixels
        length = solver.backgrounds.lengths(pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt(misfit[start:stop]) / (solver.atoms.neighbour_contrast * length)
        diagnostics: dict[str, NDArray[Any]] = {
            "footprint": footprint_sizes(pixels.coefficients),
            "estimated_error": error,
            "prediction_error": missed[start:stop],
        }
        looked_at = self._every(self._looked_at, start, stop) - start
        diagnostics |= residual_diagnostics(
            solver, samples, background, solved, pixels.coefficients, looked_at
        )
        if self._grows:
            diagnostics[SEARCHED] = neighbours.rows.diagnostics[SEARCHED][start:stop]
        further = {name: values.astype(np.float32) for name, values in diagnostics.items()}
        pixels = replace(pixels, diagnostics=dict(pixels.diagnostics) | further)
        patterns, means = self.capture.patterns, solver.backgrounds.shown_means
        return with_certainty(pixels, samples, patterns, start, self.capture.rows, means)

    def _neighbours(self, number: int, read: ReadStep) -> Neighbourhood:
        """The neighbourhood of all rows of a round, from the rows of the round before."""
        # The last round is solved twice with the same neighbourhood.
        if number not in self._latest:
            self._latest.clear()
            rows = read(round_name(number - 1))
            grid, before = self._grid(number), self._grid(number - 1)
            if grid is not before:
                # A copy without the samples that were read takes its place, to free their memory.
                self._grids[before.spacing] = replace(before)
            atoms = self.solver.atoms
            projectors = max(1, len(self.capture.projectors))
            near = Neighbourhood(rows, before.camera, atoms, before.spacing, (), projectors)
            if grid is not before:
                finer = [grid.refine_jacobian(before, part.jacobian) for part in near.parts]
                rows = grid.spread(before, rows)
                near = Neighbourhood(rows, grid.camera, atoms, grid.spacing, finer, projectors)
            neighbours = near
            self._latest[number] = neighbours
        return self._latest[number]

    @computed_once
    def _costs(self) -> list[float]:
        """The cost of each step, the frames held out before the last, in rows on likely atoms."""
        patterns = self.capture.patterns
        # Operations: a search looks at all pixels and half of the spots, a round at a row's
        # candidates.
        search = 4 * patterns.pixels / (self.solver.candidates * (patterns.count + 64))
        costs = []
        for number, step in enumerate(self.rounds):
            each = 0.5 if step.skip_every_second else 1.0
            costs.append(self._grid(number).count * (search if step.window is None else each))
        last = costs[-1]
        held_out = last / self._tested_every**2 if self.judged else 0.0
        return [*costs[:-1], held_out, last]


def round_name(number: int) -> str:
    """The step of a round."""
    return f"round-{number}"


def _for_next_round(solved: Result, before: SparseRows | None = None) -> SparseRows:
    """Rows as the next round needs them, with the diagnostics of the same rows before."""
    diagnostics = {} if before is None else before.diagnostics
    return replace(solved.rows.single(), diagnostics=diagnostics)


def _searched(solved: Result) -> SparseRows:
    """Rows of estimates from seeds that have searched all atoms, as the next round needs them."""
    ones = np.ones(solved.rows.count, np.float32)
    return replace(solved.rows.single(), diagnostics={SEARCHED: ones, CHANGE: ones})


def _mean(values: NDArray[np.float32]) -> float:
    """The mean of those that are known; NaN if none is."""
    known = np.isfinite(values)
    return float(values[known].mean(dtype=np.float64)) if known.any() else np.nan
