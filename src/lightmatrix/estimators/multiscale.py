"""Coarse to fine: finds on projector blocks where the light comes from, then refines them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.automatic_regularization import column_length
from lightmatrix.estimators.base import rows_with_diagnostics
from lightmatrix.estimators.certainty import with_certainty
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.work import ReadStep, SolveTile, Work
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.progress import Progress
from lightmatrix.solvers import solve
from lightmatrix.solvers.problem import Problem
from lightmatrix.transport.checkpoint import Span
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True, eq=False)
class Scale:
    """The patterns, as means over projector blocks of `block` pixels a side."""

    block: int
    patterns: PatternSet
    regularization: float


def active_blocks(
    coefficients: scipy.sparse.csr_array, candidates: NDArray[np.int64], grid: tuple[int, int]
) -> NDArray[np.bool_]:
    """The projector blocks from which a camera block gets its light, and their neighbours.

    `coefficients` are (m, n) on the n `candidates`, numbered in the `grid`. A block is active if
    its score is at least a tenth of the highest; all candidates are if no row has any light.
    """
    size = abs(coefficients)
    total = np.asarray(size.sum(axis=1), np.float64).ravel()
    # Each row counts by its shares, as bright rows know no more about the places than dark ones.
    score = size.T @ np.divide(1, total, out=np.zeros_like(total), where=total > 0)
    wanted = (score >= 0.1 * score.max()) & (score > 0)
    # The number of blocks with the highest scores that are kept in any case, if they have light.
    # Chosen by hand: a spot may touch four blocks, and its halo more.
    count = max(int(wanted.sum()), min(8, int((score > 0).sum())))
    if not score.any():
        count = len(candidates)
    active = np.zeros(grid, bool)
    active.ravel()[candidates[np.argsort(-score, kind="stable")[:count]]] = True
    return np.asarray(scipy.ndimage.binary_dilation(active, np.ones((3, 3), bool)))


def grid_of(shape: tuple[int, int], block: int) -> tuple[int, int]:
    """Rows and columns of blocks; those at the border may be smaller."""
    return -(-shape[0] // block), -(-shape[1] // block)


# Pixels per side of the blocks of the first scale, halved as long as the projector has no 4 x 4 of
# them, and of the camera blocks.
_BLOCK = 8


@dataclass(frozen=True)
class MultiScaleEstimator(PlainEstimator):
    """Estimates T with one solver, first on projector blocks, then inside those that matter.

    `docs/multi-scale.md` has the steps and their reasons. A tile is a strip of camera blocks.

    A further diagnostic, candidates, says on how many projector pixels each row was estimated. The
    gap is that of the restricted problem: it says nothing about pixels that a coarser scale left
    out.

    The parameters are those of `PlainEstimator`, of which `tile_rows` and `judged` have no effect.
    At coarser scales the regularization falls with the length of the patterns' columns.
    """

    name: ClassVar[str] = "multi-scale"

    def work(self, capture: Capture, regularization: float) -> Work:
        """The rows of a capture, in strips."""
        return _Strips(capture, self, regularization)


@dataclass(frozen=True, eq=False)
class _Strips(Work):
    """The rows of a capture, solved in strips of camera blocks."""

    capture: Capture
    estimator: MultiScaleEstimator
    regularization: float

    def tiles(self, step: str, parts: int = 1) -> Iterator[Span]:
        # The pixels of a block share their candidates, so that no strip cuts a block.
        rows = self.capture.camera_shape[0]
        width = self.capture.rows // rows
        for start in range(0, rows, _BLOCK):
            yield start * width, min(start + _BLOCK, rows) * width

    def prepare(self, step: str, read: ReadStep) -> SolveTile:
        return self._solve

    def _solve(self, start: int, stop: int, progress: Progress) -> SparseRows:
        samples = self.capture.samples(start, stop)
        patterns = self.capture.patterns
        strip = self.estimator.problem(patterns, samples, self.regularization)
        parts, order = [], []
        # A strip is one row of blocks.
        _, width, *channels = self.capture.camera_shape
        block = np.arange(stop - start) // (channels[0] if channels else 1) % width // _BLOCK
        for number in range(int(block.max()) + 1):
            rows = np.flatnonzero(block == number)
            parts.append(self._solve_block(strip.take(rows), samples.rows(rows)))
            order.append(rows)
            progress(sum(map(len, order)), stop - start)
        solved = SparseRows.joined(parts).rows(np.argsort(np.concatenate(order)))
        return with_certainty(solved, samples, patterns, start, self.capture.rows)

    def _solve_block(self, problem: Problem, samples: Samples) -> SparseRows:
        """The rows of one camera block, from the coarsest scale to single pixels."""
        patterns, coarsest = self.capture.patterns, self._scales[0].block
        active = np.ones(grid_of(patterns.shape, 2 * coarsest), np.bool_)
        for scale in self._scales:
            grid = grid_of(patterns.shape, scale.block)
            quarters = active.repeat(2, axis=0).repeat(2, axis=1)[: grid[0], : grid[1]]
            candidates = np.flatnonzero(quarters)
            restricted = replace(
                problem,
                patterns=ImagePatterns(scale.patterns.columns(candidates)[:, None, :]),
                # Diffuse light comes from the whole projector, whichever pixels are candidates.
                background_column=problem.column,
                regularization=scale.regularization,
            )
            result = solve(restricted, self.estimator.solver)
            if scale.block > 1:
                active = active_blocks(result.coefficients, candidates, grid)
        entries = result.coefficients.tocoo()
        coefficients = scipy.sparse.csr_array(
            (entries.data.astype(np.float32), (entries.row, candidates[entries.col])),
            shape=(problem.rows, patterns.pixels),
        )
        count = np.full(problem.rows, len(candidates), np.int32)
        rows = rows_with_diagnostics(samples, result, candidates=count)
        return replace(rows, coefficients=coefficients).rounded()

    @cached_property
    def _scales(self) -> list[Scale]:
        """The scales from blocks of `_BLOCK` pixels a side to single pixels.

        The first blocks are halved until the projector has 4 x 4 of them. The regularization of
        single pixels falls at coarser scales with the root mean square length of the patterns'
        centred columns, so that it stays at the same height above noise.
        """
        patterns, regularization, block = self.capture.patterns, self.regularization, _BLOCK
        length = column_length(patterns)
        while block > 1 and min(grid_of(patterns.shape, block)) < 4:
            block //= 2
        coarser = []
        while block > 1:
            coarse = patterns.coarse((block, block))
            shorter = column_length(coarse) / length if length > 0 else 1.0
            # The least factor by which the regularization falls at a coarser scale. Chosen by hand:
            # where the patterns hardly vary over a block, the regularization would vanish.
            coarser.append(Scale(block, coarse, regularization * max(shorter, 1e-3)))
            block //= 2
        return [*coarser, Scale(1, patterns, regularization)]
