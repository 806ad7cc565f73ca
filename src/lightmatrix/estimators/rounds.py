"""The rounds of the coherent estimate: each solves every row with what the last one found."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix import _core
from lightmatrix.capture import Capture, Samples
from lightmatrix.estimators.backgrounds import Backgrounds
from lightmatrix.estimators.expectations import (
    UNSEEN,
    Neighbourhood,
    unseen_patterns,
)
from lightmatrix.estimators.tiles import TILE_BYTES, Progress, Tile, diagnostics
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.problem import Fidelity, Problem
from lightmatrix.solvers.weighted import (
    Blocks,
    Candidates,
    Expectation,
    Start,
    WeightedResult,
    solve_weighted,
)
from lightmatrix.store import Checkpoint

# Of the clip level, and the gap: the first estimate, row by row, only has to show where light is.
FIRST_REGULARIZATION = 0.32
FIRST_TOLERANCE = 1e-2
# What neighbours' rows give is expected from the round on whose window on the projector is this
# narrow: then most rows are about right.
EXPECTING = 1


@dataclass(frozen=True)
class Known:
    """What was found of all rows, and their neighbourhood."""

    found: Start
    neighbourhood: Neighbourhood


@dataclass(frozen=True)
class Rounds:
    """See `CoherentEstimator`, whose parameters these are."""

    capture: Capture
    solver: ActiveSet
    regularization: float
    trust: float
    windows: tuple[tuple[int, int], ...]
    candidates: int
    background_grid: tuple[int, int]
    tile_rows: int | None
    progress: Progress | None

    def before_last(self, running: Checkpoint | None) -> Start:
        """What the rounds before the last one find, from where a checkpoint has come to."""
        latest, found = self._latest(running)
        for number in range(latest + 1, len(self.windows)):
            known = self.known(found)
            found = self._whole(running, number, partial(self._again, number, known))
        return found

    def known(self, found: Start) -> Known:
        """What a round knows of all rows."""
        rows, cols, *channels = self.capture.camera_shape
        camera = (rows, cols, channels[0] if channels else 1)
        return Known(found, Neighbourhood(found.coefficients, camera, self.capture.projector_shape))

    def last(self, known: Known, start: int, stop: int) -> Tile:
        """The rows start..stop of the last round."""
        samples = self.capture.samples(start, stop)
        solved = self._solve(samples, start, stop, len(self.windows), known)
        shares = self.backgrounds.spread(known.found.coefficients[start:stop])
        background = solved.rows.background[:, None] * shares
        if solved.blocks.shape[1]:
            background += solved.blocks
        sparse = csr_array(solved.rows.coefficients, dtype=np.float32)
        return sparse, background.astype(np.float32), diagnostics(samples, solved.rows)

    @cached_property
    def backgrounds(self) -> Backgrounds:
        """Blocks of the background, no more than there are pixels."""
        shape = self.capture.projector_shape
        grid = min(self.background_grid[0], shape[0]), min(self.background_grid[1], shape[1])
        return Backgrounds(grid, self.capture.patterns, unseen_patterns(shape))

    def ranges(self) -> Iterator[tuple[int, int]]:
        """Rows solved at a time."""
        # Samples and expected ones twice, and candidates with what is found of them.
        row_bytes = 32 * (self.capture.count + UNSEEN) + 32 * self.candidates
        tile = self.tile_rows or max(1, TILE_BYTES // row_bytes)
        for start in range(0, self.capture.rows, tile):
            yield start, min(start + tile, self.capture.rows)

    def _latest(self, running: Checkpoint | None) -> tuple[int, Start]:
        """The latest round that was finished, and what it found."""
        if running is not None:
            for number in reversed(range(len(self.windows))):
                if (arrays := running.recall(f"round-{number}")) is not None:
                    return number, _unpacked(arrays, self.capture)
        return 0, self._whole(running, 0, self._first)

    def _whole(
        self, running: Checkpoint | None, number: int, solve: Callable[[int, int], Start]
    ) -> Start:
        """A round over all rows; the checkpoint remembers it instead of the one before."""
        found = _joined([solve(start, stop) for start, stop in self.ranges()])
        if running is not None:
            running.remember(f"round-{number}", _packed(found))
            running.forget(f"round-{number - 1}")
        return found

    def _first(self, start: int, stop: int) -> Start:
        samples = self.capture.samples(start, stop)
        regularization = FIRST_REGULARIZATION * self.capture.reference_level
        problem = self._problem(samples, regularization)
        solver = replace(self.solver, tolerance=max(FIRST_TOLERANCE, self.solver.tolerance))
        result = solver.solve(problem, self._report(0, start))
        return _kept(WeightedResult(result, np.zeros((stop - start, 0), np.float32)))

    def _again(self, number: int, known: Known, start: int, stop: int) -> Start:
        samples = self.capture.samples(start, stop)
        return _kept(self._solve(samples, start, stop, number, known))

    def _solve(
        self, samples: Samples, start: int, stop: int, number: int, known: Known
    ) -> WeightedResult:
        """The rows start..stop, with penalties from what was found before."""
        problem = self._problem(samples, self.regularization)
        found = known.found
        expected = None
        if self.windows[number - 1][1] <= EXPECTING:
            expected = self._expected(samples, start, stop, known)
        unseen = expected is not None
        blocks = Blocks.none(self.capture.patterns, self.backgrounds.unseen if unseen else None)
        # Blocks join in the last round, when it is clear where most of the light is.
        if number == len(self.windows):
            cost = self.capture.reference_level / self.regularization
            blocks = self.backgrounds.blocks(cost, unseen=unseen)
        background = self._halos(found, start, stop)[:, : blocks.means.shape[1]]
        return solve_weighted(
            problem,
            self._candidates(found.coefficients, number, start, stop),
            blocks,
            self.solver,
            expected=expected,
            background=np.ascontiguousarray(background),
            start=Start(
                found.coefficients[start:stop],
                found.background[start:stop],
                found.blocks[start:stop],
            ),
            progress=self._report(number, start),
        )

    def _expected(self, samples: Samples, start: int, stop: int, known: Known) -> Expectation:
        """What neighbours' rows, and their backgrounds, say of the samples of start..stop."""
        neighbourhood = known.neighbourhood
        first, last = neighbourhood.around(start, stop)
        halos = self._halos(known.found, first, last)
        background = known.found.background[first:last, None].astype(np.float32) * halos
        return neighbourhood.expected(
            self.capture.patterns,
            self.backgrounds.unseen,
            samples,
            samples.clipped & (self.solver.fidelity is not Fidelity.LINEAR),
            self.capture.reference_level,
            start,
            background,
        )

    def _halos(self, found: Start, start: int, stop: int) -> NDArray[np.float32]:
        """What the backgrounds of the rows start..stop give under shown and unseen patterns."""
        backgrounds = self.backgrounds
        return backgrounds.under_patterns(backgrounds.spread(found.coefficients[start:stop]))

    def _problem(self, samples: Samples, regularization: float) -> Problem:
        return Problem(
            self.capture.patterns,
            samples.values,
            samples.clipped,
            samples.clip_level,
            regularization,
            samples.weights,
        )

    def _candidates(self, rows: csr_array, number: int, start: int, stop: int) -> Candidates:
        camera_rows, camera_cols, *channels = self.capture.camera_shape
        projector = self.capture.projector_shape
        camera_reach, projector_reach = self.windows[number - 1]
        # Footprints of neighbours lie further apart where the projector is the finer one.
        finer = max(1.0, projector[0] / camera_rows, projector[1] / camera_cols)
        indptr, pixels, shares = _core.likely_pixels(
            rows,
            (camera_rows, camera_cols, channels[0] if channels else 1),
            projector,
            (camera_reach, round(projector_reach * finer)),
            self.candidates,
            (start, stop),
        )
        penalties = 2 * self.trust / (self.trust + shares)
        return Candidates(indptr, pixels, penalties.astype(np.float32))

    def _report(self, number: int, start: int) -> Progress | None:
        report = self.progress
        if report is None:
            return None
        before = number * self.capture.rows + start
        total = self.capture.rows * (1 + len(self.windows))
        return lambda done, _: report(before + done, total)


def _kept(solved: WeightedResult) -> Start:
    coefficients = csr_array(solved.rows.coefficients, dtype=np.float32)
    return Start(coefficients, solved.rows.background.astype(np.float32), solved.blocks)


def _joined(parts: list[Start]) -> Start:
    return Start(
        csr_array(vstack([part.coefficients for part in parts], format="csr")),
        np.concatenate([part.background for part in parts]),
        np.concatenate([part.blocks for part in parts]),
    )


def _packed(found: Start) -> dict[str, NDArray[Any]]:
    rows = found.coefficients
    return {
        "data": rows.data,
        "indices": rows.indices,
        "indptr": rows.indptr,
        "background": found.background,
        "blocks": found.blocks,
    }


def _unpacked(arrays: dict[str, NDArray[Any]], capture: Capture) -> Start:
    shape = (capture.rows, capture.patterns.pixels)
    rows = csr_array((arrays["data"], arrays["indices"], arrays["indptr"]), shape=shape)
    return Start(rows, arrays["background"], arrays["blocks"])
