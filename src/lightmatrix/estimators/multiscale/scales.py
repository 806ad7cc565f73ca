"""The scales of a multi-scale estimate: patterns over projector blocks, and which blocks matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array

from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.solvers.default_regularization import column_length

# The number of blocks with the highest scores that are kept in any case, if they have light. Chosen
# by hand: a spot may touch four blocks, and its halo more.
_LEAST_KEPT = 8
# The least factor by which the regularization falls at a coarser scale. Chosen by hand: where the
# patterns hardly vary over a block, the regularization would vanish.
_LEAST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class Scale:
    """The patterns, as means over projector blocks of `block` pixels a side."""

    block: int
    patterns: PatternSet
    regularization: float

    def restricted(self, candidates: NDArray[np.int64]) -> ImagePatterns:
        """The patterns on the candidate blocks only."""
        return ImagePatterns(self.patterns.columns(candidates)[:, None, :])


def scales(patterns: PatternSet, coarsest: int, regularization: float) -> list[Scale]:
    """The scales from blocks of `coarsest` pixels a side, a power of two, to single pixels.

    `coarsest` is halved until the projector has 4 x 4 blocks. The `regularization` of single pixels
    falls at coarser scales with the root mean square length of the patterns' centred columns, so
    that it stays at the same height above noise.
    """
    length = column_length(patterns)
    block = coarsest
    while block > 1 and min(grid_of(patterns.shape, block)) < 4:
        block //= 2
    coarser = []
    while block > 1:
        coarse = patterns.coarse((block, block))
        shorter = column_length(coarse) / length if length > 0 else 1.0
        coarser.append(Scale(block, coarse, regularization * max(shorter, _LEAST_SCALE)))
        block //= 2
    return [*coarser, Scale(1, patterns, regularization)]


def active_blocks(
    coefficients: csr_array, candidates: NDArray[np.int64], grid: tuple[int, int], share: float
) -> NDArray[np.bool_]:
    """The projector blocks from which a camera block gets its light, and their neighbours.

    `coefficients` are (m, n) on the n `candidates`, numbered in the `grid`. A block is active if
    its score is at least `share` of the highest; all candidates are if no row has any light.
    """
    size = abs(coefficients)
    total = np.asarray(size.sum(axis=1), np.float64).ravel()
    # Each row counts by its shares, as bright rows know no more about the places than dark ones.
    score = size.T @ np.divide(1, total, out=np.zeros_like(total), where=total > 0)
    wanted = (score >= share * score.max()) & ((score > 0) | (share == 0))
    count = max(int(wanted.sum()), min(_LEAST_KEPT, int((score > 0).sum())))
    if not score.any():
        count = len(candidates)
    active = np.zeros(grid, bool)
    active.ravel()[candidates[np.argsort(-score, kind="stable")[:count]]] = True
    return np.asarray(binary_dilation(active, np.ones((3, 3), bool)))


def split(active: NDArray[np.bool_], finer: tuple[int, int]) -> NDArray[np.int64]:
    """Numbers of the quarters of the active blocks, in the grid `finer` of half as large blocks."""
    children = active.repeat(2, axis=0).repeat(2, axis=1)[: finer[0], : finer[1]]
    return np.flatnonzero(children)


def grid_of(shape: tuple[int, int], block: int) -> tuple[int, int]:
    """Rows and columns of blocks; those at the border may be smaller."""
    return -(-shape[0] // block), -(-shape[1] // block)
