"""Solves rows of the coherent estimate: on all atoms, or on the likely ones.

A row's sparse part holds the pixels that it sees well. The rest of the light is spread widely, but
not evenly: light that comes by way of another surface falls off with its distance. So a row has one
unpenalised coefficient for a halo around its sparse part, and penalised coefficients of coarse
cells of projector pixels for light that differs from the halo.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.coherent.neighbourhood import (
    PSEUDO_SAMPLES,
    REACH,
    Neighbourhood,
    unseen_patterns,
)
from lightmatrix.estimators.coherent.schedule import KEPT_PIXELS, Round
from lightmatrix.patterns.atoms import AtomPatterns, Sheet, boxes_around
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.progress import Progress
from lightmatrix.resources.threads import computed_once
from lightmatrix.solvers.active_set import ActiveSet, Candidates, Cells, solve_weighted
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result, Status
from lightmatrix.transport.operator import cell_means
from lightmatrix.transport.sparse_rows import SparseRows

# At a distance of d the halo is 1 / (d^2 + c^2)^2, as the light of a patch in front of a wall at a
# distance of c. This is c as a share of the projector's longer side. Measured on `l_objects` at 64
# mixed patterns: rows of mostly global light err by 0.129, and by 0.135 with c = 2 squares, which
# makes halos too narrow nearby and too bright far away.
WALL = 1 / 8


@dataclass(frozen=True)
class Backgrounds:
    """B coarse cells of projector pixels, their means under all patterns, and halos on them."""

    grid: tuple[int, int]
    shown: PatternSet
    unseen: PatternSet

    def spread(self, rows: csr_array) -> NDArray[np.float32]:
        """The shares of the halo of each row (m, N) in the cells, (m, B); even if it is empty."""
        down, right = _squares(self.shown.shape)
        squares = csr_array(
            (rows.data, self._square[rows.indices], rows.indptr), (rows.shape[0], down * right)
        )
        shares = np.asarray(squares @ self._halos)
        total = shares.sum(axis=1, keepdims=True)
        even = (self._sizes / self._sizes.sum()).astype(np.float32)
        return np.where(total > 0, shares / np.where(total > 0, total, 1), even)

    def under_patterns(self, shares: NDArray[np.float32]) -> NDArray[np.float32]:
        """The halos under the patterns, shown and unseen, (m, K + E) in [0, 1]."""
        under = _core.rows_times(shares, self._means)
        return np.clip(under, 0, 1, out=under)

    def cells(self, cost: float, *, unseen: bool) -> Cells:
        """The cells as columns; `cost` is the clip level over the regularization."""
        if self.grid == (1, 1):
            return Cells.none(self.shown, self.unseen if unseen else None)
        # The penalty of a cell's coefficient is this share of the clip level over the side of the
        # cell in pixels. Three times as much or as little changes errors by about a tenth
        # (docs/coherent.md).
        penalties = 0.05 * cost / np.sqrt(self._sizes)
        count = None if unseen else self.shown.count
        return Cells(np.ascontiguousarray(self._means[:, :count]), penalties.astype(np.float32))

    @property
    def shown_means(self) -> NDArray[np.float32]:
        """Mean of each pattern shown over each cell, (B, K) in [0, 1]."""
        return self._means[:, : self.shown.count]

    def lengths(self, rows: SparseRows) -> NDArray[np.float64]:
        """Euclidean norm of each row of pixels and cells, (m,), as if they did not overlap."""
        squares = rows.coefficients.multiply(rows.coefficients).sum(axis=1)
        spread = (rows.background.astype(np.float64) ** 2) @ (1 / self._sizes)
        return np.sqrt(np.asarray(squares, np.float64).ravel() + spread)

    @property
    def brightness(self) -> NDArray[np.float64]:
        """Mean of each pattern shown, (K,) in [0, 1]."""
        return np.asarray(self._sizes @ self.shown_means / self._sizes.sum(), np.float64)

    @computed_once
    def _pooling(self) -> csr_array:
        return cell_means(self.shown.shape, self.grid)

    @computed_once
    def _sizes(self) -> NDArray[np.float64]:
        return np.asarray(np.diff(self._pooling.indptr), np.float64)

    @computed_once
    def _means(self) -> NDArray[np.float32]:
        """Mean of each pattern over each cell, (B, K + E) in [0, 1]."""
        chunks = (chunk for one in (self.shown, self.unseen) for _, chunk in one.chunks())
        parts = [self._pooling @ chunk.T for chunk in chunks]
        return np.clip(np.concatenate(parts, axis=1), 0, 1).astype(np.float32)

    @computed_once
    def _square(self) -> NDArray[np.int64]:
        return _square_of_each(self.shown.shape)

    @computed_once
    def _halos(self) -> NDArray[np.float32]:
        """The light of each cell in the halo around each square, (squares, B)."""
        return _halos(self.shown.shape, self.grid)


def _side(shape: tuple[int, int]) -> int:
    # Halos are computed on at most this many squares along the projector's longer side. Chosen by
    # hand: halos are smooth.
    return -(-max(shape) // 128)


def _squares(shape: tuple[int, int]) -> tuple[int, int]:
    return -(-shape[0] // _side(shape)), -(-shape[1] // _side(shape))


def _square_of_each(shape: tuple[int, int]) -> NDArray[np.int64]:
    """The square of each pixel, (N,)."""
    r, c = np.indices(shape) // _side(shape)
    return np.asarray(r * _squares(shape)[1] + c).ravel()


# The estimate of a capture begins with estimates of a part of it, of the same projector.
@lru_cache(maxsize=2)
def _halos(shape: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.float32]:
    """The light of each of the B cells of a grid in the halo around each square, (squares, B)."""
    (rows, cols), square = _squares(shape), _square_of_each(shape)
    down, right = np.ogrid[1 - rows : rows, 1 - cols : cols]
    kernel = 1 / (down**2 + right**2 + (WALL * max(rows, cols)) ** 2) ** 2
    # Convolution by scipy.fft, as importing scipy.signal takes a second.
    sides = zip(kernel.shape, (rows, cols), strict=True)
    fast = [scipy.fft.next_fast_len(n + m - 1, True) for n, m in sides]
    spread = scipy.fft.rfft2(kernel, fast)
    pooling = cell_means(shape, grid)
    result = np.empty((rows * cols, pooling.shape[0]), np.float32)
    for cell, (first, last) in enumerate(pairwise(pooling.indptr)):
        # The number of the cell's pixels in each square.
        counts = np.bincount(square[pooling.indices[first:last]], minlength=rows * cols)
        light = scipy.fft.irfft2(scipy.fft.rfft2(counts.reshape(rows, cols), fast) * spread, fast)
        near = light[rows - 1 : 2 * rows - 1, cols - 1 : 2 * cols - 1]
        result[:, cell] = np.maximum(near, 0).ravel()
    result.setflags(write=False)
    return result


# lambda relative to the clip level. Errors are flat around it: three times as much or as little
# changes them by about a tenth (docs/coherent.md).
DEFAULT_REGULARIZATION = 0.1
# lambda relative to the clip level in the first round, which only has to show where light may be.
# Chosen by hand.
FIRST_REGULARIZATION = 0.32


# Seeds look for spots of every so-manieth size. They suffice to find light (errors differ by less
# than 1 %), and take half of the time.
_SOUGHT = 2
# The side in pixels of the squares of a larger projector that are searched in turn, each a quarter
# of `KEPT_PIXELS`.
_SQUARE = 512


def in_parts(capture: Capture) -> bool:
    """Whether not all atoms of a capture are kept."""
    return capture.patterns.pixels > KEPT_PIXELS and not capture.projectors


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
    # Rows that are solved together where the projector is solved in parts.
    together: int = 4096

    @computed_once
    def atoms(self) -> AtomPatterns:
        """Pixels and spots under the patterns shown."""
        patterns, wide = self.capture.patterns, self._sees_wide_spots
        # The standard deviation of a spot is at most this share of the projector's shorter side.
        # Chosen by hand.
        widest = min(patterns.shape) / 8 if wide else min(4.0, min(patterns.shape) / 16)
        sizes = tuple(size for size in self.sizes if size <= widest)
        return AtomPatterns(patterns, sizes, narrow=self.narrow, even=wide)

    @computed_once
    def _sees_wide_spots(self) -> bool:
        """Whether a tenth of the bright pixels change less than a spot of 5.6 pixels does.

        Eight frames tell the blur of most bright pixels to a fifth, so that this holds from about
        4 pixels on. Narrow spots are better up to 3.4.
        """
        frames = np.linspace(0, self.capture.count - 1, min(8, self.capture.count)).astype(int)
        some = self.capture.select(frames)
        tiles = [tile.values[~tile.clipped.any(axis=1)] for _, tile in some.tiles()]
        means, changes = (
            np.concatenate([of(tile, axis=1) for tile in tiles]) for of in (np.mean, np.std)
        )
        bright = means > max(means.mean(), 0) if len(means) else means > 0
        if not bright.any():
            return False
        spot = AtomPatterns(some.patterns, (0.0, 5.6), (1.0, 1.0), even=True).contrast(1)
        change = np.quantile(changes[bright] / means[bright], 0.1)
        return bool(change * some.patterns.means.mean() < spot)

    @computed_once
    def unseen(self) -> AtomPatterns:
        """Pixels and spots under the patterns that were never shown."""
        atoms = self.atoms
        return AtomPatterns(unseen_patterns(atoms.shape), atoms.sizes, atoms.gains, self.narrow)

    @computed_once
    def level(self) -> float:
        """The clip level, in proportion to the contrast of the patterns."""
        # The contrast of patterns that regularizations are for, the standard deviation of their
        # values. Random patterns with half of the pixels lit have it; for others lambda changes in
        # proportion.
        contrast = self.atoms.single_contrast / 0.5
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
        shape, several = self.capture.projector_shape, max(1, len(self.capture.projectors))
        # Wide spots cannot be told from cells and halos.
        down, right = (1, 1) if self._sees_wide_spots else self.background_grid
        grid = min(several * down, shape[0]), min(right, shape[1])
        return Backgrounds(grid, self.capture.patterns, self.unseen.single)

    @property
    def sought(self) -> AtomPatterns:
        """The atoms of fewer sizes, by which seeds search."""
        return self.atoms.part(every=_SOUGHT)

    def everywhere(
        self, samples: Samples, sought: AtomPatterns, progress: Progress | None = None,
        squares: NDArray[np.bool_] | None = None,
    ) -> Result:  # fmt: skip
        """Solve each row by itself on the atoms `sought`, in one pass over them.

        Where not all atoms are kept, those sought are made square by square; each row can then be
        searched in some of the squares only, (m, S).
        """
        problem = self.first_problem(samples)
        # Until the gap is 1 % there would be 3.5 to 5 passes. But every row has neighbours that
        # have searched, too, so that one gives the same errors.
        solver = replace(self.solver, tolerance=max(1e-2, self.solver.tolerance), max_passes=1)
        if not in_parts(self.capture):
            solved = solver.solve(replace(problem, patterns=sought), progress)
            if sought is self.atoms:
                return solved
            whole = Sheet.whole(self.atoms.shape)
            return replace(solved, rows=self._lifted(solved.rows, whole))
        (rows, cols), reach = self.atoms.shape, len(self.atoms.kernels[-1]) - 1
        problem = replace(problem, background_column=self.capture.patterns.means)
        best, before = None, np.full(problem.rows, np.inf)
        corners = product(range(0, rows, _SQUARE), range(0, cols, _SQUARE))
        for number, corner in enumerate(corners):
            some = np.arange(problem.rows)
            some = some if squares is None else some[squares[:, number]]
            if not len(some):
                continue
            sides = zip(corner, (rows, cols), strict=True)
            square = tuple(slice(max(0, n - reach), min(n + _SQUARE + reach, m)) for n, m in sides)
            sheet = Sheet.of([square], (rows, cols), 0)
            patterns = self.atoms.part(sheet.pixels, every=_SOUGHT)
            part = replace(problem, patterns=patterns, samples=samples.rows(some))
            found = self._lifted(solver.solve(part, progress).rows, sheet)
            if best is None:
                # Any rows, until each has its own.
                best = found.rows(np.zeros(problem.rows, np.int64))
            # A row keeps the square that explains its samples best.
            left_over = found.diagnostics["objective"]
            better = np.flatnonzero(~(left_over >= before[some]))
            before[some[better]] = left_over[better]
            best = best.replaced(some[better], found.rows(better))
        assert best is not None
        return Result(best, Status.CONVERGED)

    def _lifted(self, found: SparseRows, sheet: Sheet) -> SparseRows:
        """Rows on the atoms of a sheet of every second size, as rows of all atoms."""
        lifted = sheet.lifted(found.coefficients, self.atoms.planes, _SOUGHT)
        return replace(found, coefficients=lifted)

    def squares_seen(
        self, rows: NDArray[np.int64], neighbours: Neighbourhood
    ) -> NDArray[np.bool_] | None:
        """The squares of the projector that some rows or those around them see, (m, S)."""
        if not in_parts(self.capture):
            return None
        near, own = neighbours.part(rows, 16)
        light = near.rows.coefficients
        row, col = np.divmod(light.indices % self.atoms.single.pixels, self.atoms.shape[1])
        down, right = (-(-side // _SQUARE) for side in self.atoms.shape)
        seen = np.zeros((near.rows.count, down * right), np.bool_)
        owner = np.repeat(np.arange(near.rows.count), np.diff(light.indptr))
        seen[owner, row // _SQUARE * right + col // _SQUARE] = True
        around = scipy.ndimage.maximum_filter(
            seen.reshape(*near.camera, -1), size=(33, 33, near.camera[2], 1)
        )
        some = around.reshape(seen.shape)[own]
        # Rows in the dark may see anything.
        return np.asarray(some | ~some.any(axis=1, keepdims=True))

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
        # The norm of an atom's column is at most this times its contrast times the root of the
        # number of patterns. Chosen by hand.
        bright = np.sqrt(left) * 1.5 * column > FIRST_REGULARIZATION * self.level
        penalty = self.penalty * np.sqrt(left) / column
        wrong = solved.rows.diagnostics["objective"] > share * left / 2 + penalty
        return np.flatnonzero(bright & wrong)

    def near(
        self, samples: Samples, rows: NDArray[np.int64], this_round: Round,
        neighbours: Neighbourhood, progress: Progress | None = None, *, together: bool = False,
    ) -> tuple[Result, NDArray[np.float32]]:  # fmt: skip
        """Solve rows, ascending, on their likeliest atoms; returns samples of their halos too.

        Where not all atoms are kept they are solved in parts, unless they are such a part.
        """
        if in_parts(self.capture) and not together:
            return self._by_parts(samples, rows, this_round, neighbours, progress)
        assert this_round.window is not None
        problem, atoms, unseen = self._problem(samples, self.penalty), self.atoms, self.unseen
        known = samples.counted & ~samples.clipped
        # Coefficients are larger where wide spots set the gains. Spots would grow too wide else:
        # metal at blur 4 would err by 0.110 in place of 0.059.
        trust = self.trust * (3 if self._sees_wide_spots else 1)
        candidates = neighbours.likely_atoms(
            this_round.window, self.candidates, trust, known.sum(axis=1), rows,
            first=this_round.age == 1,
        )  # fmt: skip
        start, near, sheet = neighbours.rows.rows(rows), neighbours, None
        if in_parts(self.capture):
            near, rows = neighbours.part(rows, REACH)
            boxes = boxes_around(candidates.indices % atoms.single.pixels, atoms.shape)
            sheet = Sheet.of(boxes, atoms.shape, self._margin(near, this_round))
            parts = candidates.data, candidates.indices, candidates.indptr
            laid = sheet.laid(csr_array(parts, (len(rows), atoms.pixels)))
            candidates = Candidates(laid.indptr.astype(np.int64), laid.indices, laid.data)
            shown = atoms.part(sheet.pixels)
            if this_round.has_pseudo_samples:
                unseen = unseen.part(sheet.pixels)
            else:
                shown = replace(shown, wanted=np.unique(laid.indices))
            problem = replace(problem, patterns=shown)
            start = replace(start, coefficients=sheet.laid(start.coefficients))
        first, last = int(rows[0]), int(rows[-1]) + 1
        if this_round.has_pseudo_samples:
            first, last = near.around(first, last)
        halos = self.halos(near, first, last)
        pseudo_samples = None
        if this_round.has_pseudo_samples:
            light = near.rows.background[first:last]
            if sheet is not None:
                laid = sheet.laid(near.rows.coefficients)
                moved = replace(near.rows, coefficients=laid)
                near = replace(near, rows=moved, atoms=shown)
            pseudo_samples = near.pseudo_samples(
                unseen, samples, samples.clipped & Fidelity(self.solver.fidelity).term.clip_aware,
                self.capture.reference_level, rows, light * halos,
            )  # fmt: skip
        cells = Cells.none(self.capture.patterns, unseen if pseudo_samples is not None else None)
        # Cells join in the last round, when it is clear where most of the light is.
        if this_round.last:
            cost = self.level / problem.regularization
            cells = self.backgrounds.cells(cost, unseen=pseudo_samples is not None)
        halos = np.ascontiguousarray(halos[rows - first, : cells.means.shape[1]])
        solved = solve_weighted(
            problem, candidates, cells, self.solver, pseudo_samples=pseudo_samples,
            background=halos, start=start, progress=progress,
        )  # fmt: skip
        if sheet is not None:
            lifted = sheet.lifted(solved.coefficients, atoms.planes)
            solved = replace(solved, rows=replace(solved.rows, coefficients=lifted))
        return solved, halos

    def _by_parts(
        self, samples: Samples, rows: NDArray[np.int64], this_round: Round,
        neighbours: Neighbourhood, progress: Progress | None,
    ) -> tuple[Result, NDArray[np.float32]]:  # fmt: skip
        groups, parts, halos, done = [], [], [], 0
        for some in self._groups(rows, this_round, neighbours):
            # Where no neighbour holds light, the core looks this many camera pixels further.
            part, own = neighbours.part(rows[some], 16)
            solved, halo = self.near(samples.rows(some), own, this_round, part, together=True)
            done += len(some)
            if progress is not None:
                progress(done, len(rows))
            groups.append(some)
            parts.append(solved.rows)
            halos.append(halo)
        order = np.argsort(np.concatenate(groups))
        joined = SparseRows.joined(parts).rows(order)
        return Result(joined, Status.CONVERGED), np.concatenate(halos)[order]

    def _margin(self, neighbours: Neighbourhood, this_round: Round) -> int:
        """Pixels around the light of neighbours that a sheet holds, for spots and for movements."""
        steps = np.abs(neighbours.jacobian).reshape(-1, 2, 2).sum(axis=2)
        moved = 1 + int(np.ceil(REACH * steps.max())) if this_round.has_pseudo_samples else 0
        return len(self.atoms.kernels[-1]) - 1 + moved

    def _groups(
        self, rows: NDArray[np.int64], this_round: Round, neighbours: Neighbourhood
    ) -> Iterator[NDArray[np.int64]]:
        """Cut rows into parts of the camera that see small parts of the projector each."""
        count = self.capture.count + PSEUDO_SAMPLES.unseen * this_round.has_pseudo_samples
        # Bytes of the atoms at a pixel, and of those that are being made.
        each = count * (self.atoms.planes * (2 if self.narrow else 4) + 8)
        most = self.together * coherent_row_bytes(self.capture.count) / each
        waiting = [(np.arange(len(rows)), np.inf)]
        while waiting:
            some, before = waiting.pop()
            row, col, _ = np.unravel_index(rows[some], neighbours.camera)
            near, _ = neighbours.part(rows[some], REACH)
            wider = 2 * self._margin(near, this_round)
            boxes = boxes_around(near.centres.indices, self.atoms.shape)
            sizes = ([s.stop - s.start + wider for s in box] for box in boxes)
            size = sum(high * wide for high, wide in sizes)
            place = row if np.ptp(row) > np.ptp(col) else col
            # Halves that see much the same light are not cut further, unless they take too much.
            fits = size <= most or 0.7 * before < size <= 4 * most
            if (len(some) <= self.together and fits) or not np.ptp(place):
                yield some
            else:
                first = 2 * place <= place.min() + place.max()
                waiting += [(some[~first], size), (some[first], size)]

    def halos(self, neighbours: Neighbourhood, start: int, stop: int) -> NDArray[np.float32]:
        """The halos of the rows start..stop under the patterns shown and unseen, (n, K + E)."""
        shares = self.backgrounds.spread(csr_array(neighbours.centres[start:stop]))
        return self.backgrounds.under_patterns(shares)

    def first_problem(self, samples: Samples) -> Problem:
        """The problem of rows of which nothing is known."""
        return self._problem(samples, FIRST_REGULARIZATION * self.level)

    def _problem(self, samples: Samples, penalty: float) -> Problem:
        """The problem of rows of atoms, for a penalty of single pixels."""
        return Problem(self.atoms, samples, penalty * self.atoms.gains[0])


def coherent_row_bytes(count: int, candidates: int = 250) -> int:
    """Bytes that a row of the coherent estimate takes while it is solved."""
    # Samples and pseudo-samples twice, and the candidates with their coefficients.
    return 32 * (count + PSEUDO_SAMPLES.unseen) + 32 * candidates
