"""What the rows around say of a row: which atoms it probably holds, what its samples probably are.

Neighbouring camera pixels have much the same footprint, moved by a pixel or so. Where neighbours'
rows, moved back, hold light, there a row is likely to hold some. And each neighbour's row, moved
back and scaled to the samples that are known, is a guess at this one. Guesses count by how well
they explain these samples, and the expected samples are their mean; where guesses differ little,
little is left to doubt. Such samples stand in for clipped ones, and for patterns that were never
shown (`docs/few-patterns.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.movement import measured_movement
from lightmatrix.estimators.coherent.pooling import mean_around
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.weighted import Candidates, Expectation
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
# They help rows of few known samples. With more than this many they weigh less, by the square of
# the proportion: what a row says of itself grows with its samples, what neighbours err in common
# stays.
ENOUGH = 32
# By this share of what makes a spot likely the pixels within it become likely too: little at first,
# for single pixels explain everything, noise as well; more once they are believed in only where
# they were needed.
WITHIN_AT_FIRST, WITHIN = 0.04, 0.5
# By this share of what makes a pixel likely, and of what makes a spot likely, the next wider spot
# in its place becomes likely too: several narrow spots are often one that is wider, and cheaper.
WIDER_PIXEL, WIDER_SPOT = 0.25, 2.0
# Single pixels are believed in to the full where they hold this share of the light around, and by
# this power of it where they hold less, down to the least: where footprints are wide the first
# rounds give them a twentieth, from which they must not grow, and where they are not a fifth.
PIXELS_BELIEVED, PIXELS_POWER, PIXELS_LEAST = 0.25, 6, 0.001
# Around is a square of so many camera pixels.
PIXELS_AROUND = 9
# Lighter samples are left out.
LEAST_WEIGHT = 1e-4
# By how much more neighbours must hold of an atom, as a factor less one, where all of a row's light
# is in its background; by the square of the share where less is. Measured: rows that hold mostly
# global light err by 6 % less, and others hardly notice.
SPREAD = 6.0


def unseen_patterns(shape: tuple[int, int]) -> PatternSet:
    """The patterns that nobody shows."""
    return BernoulliPatterns(shape, UNSEEN, seed=UNSEEN_SEED)


@dataclass(frozen=True)
class Neighbourhood:
    """All rows as they were found, and how their footprints move.

    Parameters
    ----------
    rows : SparseRows
        M rows of coefficients of atoms, with one background coefficient each.
    camera : (int, int, int)
        Rows, columns and channels of the camera, M in all.
    atoms : AtomPatterns
        What the atoms give under the patterns shown.
    spacing : int
        Every so-manieth pixel of the camera is a row, both ways.
    moved : (M, 4) float32, optional
        How footprints move, where that is known already. None: it is measured.
    """

    rows: SparseRows
    camera: tuple[int, int, int]
    atoms: AtomPatterns
    spacing: int = 1
    moved: NDArray[np.float32] | None = None

    def around(self, start: int, stop: int) -> tuple[int, int]:
        """Range of the rows that start..stop have around them."""
        _, cols, channels = self.camera
        reach = (REACH * cols + REACH) * channels
        return max(0, start - reach), min(self.rows.count, stop + reach)

    def expected(
        self,
        unseen: PatternSet,
        samples: Samples,
        clipped: NDArray[np.bool_],
        level: float,
        rows: NDArray[np.int64],
        background: NDArray[np.float32],
    ) -> Expectation:
        """Expected samples of some rows, in place of clipped ones and under unseen patterns.

        Parameters
        ----------
        unseen : PatternSet
            E patterns over the same atoms.
        samples : Samples
            (m, K), of these rows.
        clipped : (m, K) bool
            Samples that are lower bounds.
        level : float
            Clip level that deviations are relative to.
        rows : (m,) int
            Ascending.
        background : (n, K + E) float32
            What the backgrounds of the rows `around` the first to the last give under all patterns.
        """
        values, variances = _core.expected_samples(
            self.atoms.prepared,
            unseen.prepared,
            replace(samples, clipped=clipped),
            self,
            background,
            reach=REACH,
            start=int(rows[0]),
            level=level,
            index=rows - rows[0],
        )
        count = self.atoms.count
        np.maximum(values[:, :count], samples.clip_level, out=values[:, :count], where=clipped)
        # 1 / (1 + (variance + (COMMON_ERROR value)^2) / (SAMPLE_DEVIATION level)^2), in place.
        weight = np.square(values)
        weight *= np.float32(COMMON_ERROR**2)
        weight += variances
        weight /= np.float32((SAMPLE_DEVIATION * level) ** 2)
        weight += 1
        np.reciprocal(weight, out=weight)
        weight[:, :count] *= clipped
        # Masked rows, none of whose samples counts, stay empty.
        used = samples.counted
        known = (used & ~clipped).sum(axis=1, keepdims=True)
        helped = np.minimum(1, (ENOUGH / np.maximum(known, 1)) ** 2)
        weight *= (helped * used.any(axis=1, keepdims=True)).astype(np.float32)
        weight[weight < LEAST_WEIGHT] = 0
        return Expectation(unseen, values, weight)

    @property
    def projector(self) -> tuple[int, int, int]:
        """Planes, rows and columns of the atoms."""
        return self.atoms.planes, *self.atoms.shape

    @cached_property
    def movement(self) -> NDArray[np.float32]:
        """Projector rows and columns that footprints move a camera row and a camera column on.

        (M, 4) float32: rows by rows, rows by columns, columns by rows, columns by columns.
        """
        if self.moved is not None:
            return self.moved
        found = self.rows.coefficients
        return measured_movement(found, self.camera, self.atoms.shape, self.spacing)

    @cached_property
    def centres(self) -> csr_array:
        """The rows' light at the middles of their spots, (M, N)."""
        return self.atoms.centres(self.rows.coefficients)

    @cached_property
    def singles(self) -> NDArray[np.float32]:
        """How far single pixels are believed in, in [0, 1], by the light they hold around, (M,)."""
        found = self.rows.coefficients
        single = np.where(found.indices < self.atoms.single.pixels, found.data, 0)
        pixels = csr_array((single, found.indices, found.indptr), shape=found.shape)
        whole = found.sum(axis=1).reshape(self.camera)
        part = pixels.sum(axis=1).reshape(self.camera)
        lit = whole > 0
        share = np.divide(part, whole, out=np.zeros(self.camera), where=lit)
        around = np.nan_to_num(mean_around(share, lit, PIXELS_AROUND))
        belief = np.clip((around / PIXELS_BELIEVED) ** PIXELS_POWER, PIXELS_LEAST, 1)
        return belief.astype(np.float32).ravel()

    def likely(
        self,
        reach: tuple[int, int],
        most: int,
        trust: float,
        known: NDArray[np.integer],
        rows: NDArray[np.int64],
        *,
        first: bool = False,
    ) -> Candidates:
        """The likeliest atoms of some rows, with penalties by what neighbours hold.

        Parameters
        ----------
        reach : (int, int)
            Half widths of the windows, in camera and projector pixels.
        most : int
            Atoms kept of each row.
        trust : float
            How little light among the neighbours makes an atom likely, for 32 known samples.
        known : (m,) int
            Samples of the rows that are neither clipped nor left out.
        rows : (m,) int
            Ascending.
        first : bool
            Whether nothing was settled yet, and single pixels are believed in everywhere.
        """
        wider = np.full(self.atoms.planes, WIDER_SPOT, np.float32)
        wider[0] = WIDER_PIXEL
        indptr, atoms, penalties = _core.likely_pixels(
            self.rows.coefficients,
            self.camera,
            self.projector,
            self.movement,
            self.atoms.spots,
            WITHIN_AT_FIRST if first else WITHIN,
            wider,
            np.ones(self.rows.count, np.float32) if first else self.singles,
            reach,
            most,
            trust * self._independence(known, rows),
            (0, self.rows.count),
            rows,
        )
        return Candidates(indptr, atoms, penalties)

    def _independence(
        self, known: NDArray[np.integer], rows: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """How far rows can do without neighbours, (m,); 1 with `ENOUGH` known samples.

        Less with fewer samples for each pixel that a row may see: where footprints move by some
        pixels from one camera pixel to the next, they are about as large. More where most of the
        light is in the background, as faint light of single pixels is likely to be, too.
        """
        moved = self.movement[rows].astype(np.float64) / self.spacing
        larger = np.maximum(np.hypot(moved[:, 0], moved[:, 2]), np.hypot(moved[:, 1], moved[:, 3]))
        enough = np.clip(known, 1, ENOUGH) / ENOUGH / np.maximum(larger, 1)
        return enough * (1 + SPREAD * self._spread[rows] ** 2)

    @cached_property
    def _spread(self) -> NDArray[np.float64]:
        """Share of each row's light that its background holds, (M,)."""
        background = self.rows.background.sum(axis=1, dtype=np.float64)
        whole = background + np.asarray(self.rows.coefficients.sum(axis=1), np.float64).ravel()
        return np.divide(background, whole, out=np.zeros_like(whole), where=whole > 0)
