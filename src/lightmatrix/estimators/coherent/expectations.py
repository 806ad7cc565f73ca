"""What a row's samples probably are: what its neighbours' rows would give in its place.

Neighbouring camera pixels have much the same footprint, moved by a pixel or so. Each neighbour's
row, moved back and scaled to the samples that are known, is a guess at this one. Guesses count by
how well they explain these samples, and the expected samples are their mean; where guesses differ
little, little is left to doubt. Such samples stand in for clipped ones, and for patterns that were
never shown (`docs/few-patterns.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.camera.samples import Samples
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.weighted import Expectation
from lightmatrix.transport.sparse_rows import SparseRows

# Half width of the window of neighbours that are asked.
REACH = 2
# Patterns never shown, and their seed, which nobody else has.
UNSEEN = 64
UNSEEN_SEED = 0x5EED_0F_64
# Of the clip level: deviation of a sample that was taken. An expected one with deviation d has the
# weight 1 / (1 + (d / this)^2).
SAMPLE_DEVIATION = 0.0033
# Guesses are never surer than this share of their mean: neighbours err alike.
COMMON_ERROR = 0.02
# They help rows of few known samples. With more than this many they weigh less in proportion, for
# what neighbours err in common does not average out.
ENOUGH = 16
# Lighter samples are left out.
LEAST_WEIGHT = 1e-4
# Movement is measured between the strongest pixels of rows that lie this far to both sides, as the
# median over a window of so many camera pixels, and no faster than so many projector pixels a
# camera pixel (times the ratio of their numbers).
MOVEMENT_STEP = 2
MOVEMENT_WINDOW = 9
FASTEST = 3


def unseen_patterns(shape: tuple[int, int]) -> PatternSet:
    """The patterns that nobody shows."""
    return BernoulliPatterns(shape, UNSEEN, seed=UNSEEN_SEED)


@dataclass(frozen=True)
class Neighbourhood:
    """All rows as they were found, and how their footprints move.

    Parameters
    ----------
    rows : SparseRows
        M rows, with one background coefficient each.
    camera : (int, int, int)
        Rows, columns and channels of the camera, M in all.
    projector : (int, int)
        Rows and columns of the projector, N in all.
    """

    rows: SparseRows
    camera: tuple[int, int, int]
    projector: tuple[int, int]

    def around(self, start: int, stop: int) -> tuple[int, int]:
        """Range of the rows that start..stop have around them."""
        _, cols, channels = self.camera
        reach = (REACH * cols + REACH) * channels
        return max(0, start - reach), min(self.rows.count, stop + reach)

    def expected(
        self,
        shown: PatternSet,
        unseen: PatternSet,
        samples: Samples,
        clipped: NDArray[np.bool_],
        level: float,
        start: int,
        background: NDArray[np.float32],
    ) -> Expectation:
        """Expected samples of some rows, in place of clipped ones and under unseen patterns.

        Parameters
        ----------
        shown, unseen : PatternSet
            K and E patterns.
        samples : Samples
            (m, K), of the rows start..start + m.
        clipped : (m, K) bool
            Samples that are lower bounds.
        level : float
            Clip level that deviations are relative to.
        start : int
            The first of the rows.
        background : (n, K + E) float32
            What the backgrounds of the rows `around` give under all patterns.
        """
        weights = samples.weights
        values, variances = _core.expected_samples(
            shown.prepared,
            unseen.prepared,
            replace(samples, clipped=clipped),
            self,
            background,
            reach=REACH,
            start=start,
            level=level,
        )
        count = shown.count
        np.maximum(values[:, :count], samples.clip_level, out=values[:, :count], where=clipped)
        deviations = (variances + (COMMON_ERROR * values) ** 2) / (SAMPLE_DEVIATION * level) ** 2
        weight = (1 / (1 + deviations)).astype(np.float32)
        weight[:, :count] *= clipped
        # Masked rows, none of whose samples counts, stay empty.
        used = np.broadcast_to(weights is None or weights > 0, clipped.shape)
        known = (used & ~clipped).sum(axis=1, keepdims=True)
        weight *= used.any(axis=1, keepdims=True) * np.minimum(1, ENOUGH / np.maximum(known, 1))
        weight[weight < LEAST_WEIGHT] = 0
        return Expectation(unseen, values, weight)

    @cached_property
    def movement(self) -> NDArray[np.float32]:
        """Projector rows and columns that footprints move a camera row and a camera column on.

        (M, 4) float32: rows by rows, rows by columns, columns by rows, columns by columns.
        """
        shape = self.camera
        window = (MOVEMENT_WINDOW, MOVEMENT_WINDOW, 1)
        result = np.empty((*shape, 4), np.float32)
        for i, place in enumerate(np.divmod(_strongest(self.rows.coefficients), self.projector[1])):
            fastest = FASTEST * max(1.0, self.projector[i] / shape[i])
            for axis in (0, 1):
                slope = _slope(place.reshape(shape), axis)
                slope = median_filter(slope, size=window, mode="nearest")
                result[..., 2 * i + axis] = np.clip(slope, -fastest, fastest)
        return result.reshape(-1, 4)


def _strongest(rows: csr_array) -> NDArray[np.int64]:
    """The strongest pixel of each row, (M,); 0 in empty rows."""
    entries = np.diff(rows.indptr)
    order = np.lexsort((rows.data, np.repeat(np.arange(len(entries)), entries)))
    result = np.zeros(len(entries), np.int64)
    some = entries > 0
    result[some] = rows.indices[order[rows.indptr[1:][some] - 1]]
    return result


def _slope(place: NDArray[np.int64], axis: int) -> NDArray[np.float32]:
    """Differences along an axis to both sides, over the distance; 0 on a single pixel."""
    length = place.shape[axis]
    index = np.arange(length)
    before = np.maximum(index - MOVEMENT_STEP, 0)
    after = np.minimum(index + MOVEMENT_STEP, length - 1)
    distance = np.maximum(after - before, 1).reshape(-1, *[1] * (place.ndim - 1 - axis))
    return ((place.take(after, axis) - place.take(before, axis)) / distance).astype(np.float32)
