"""What the rows around a row say of it: which atoms it probably holds, and its pseudo-samples.

Neighbouring camera pixels have much the same footprint, moved by a pixel or so. Where neighbours'
rows, moved back by the Jacobian, hold light, there a row is likely to hold some. And each
neighbour's row, moved back and scaled to the known samples, is a guess at this one. Guesses count
by how well they explain these samples. The pseudo-samples are their mean; the less the guesses
differ, the more the pseudo-samples weigh. They stand in for clipped samples and for patterns that
were never shown (`docs/few-patterns.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.camera_grid import mean_around
from lightmatrix.estimators.coherent.correspondence import measure_jacobian
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.computed_once import computed_once
from lightmatrix.solvers.weighted import Candidates, PseudoSamples
from lightmatrix.transport.sparse_rows import SparseRows

# Half width, in camera pixels, of the window of neighbours that guess a row's samples. Chosen by
# hand: it is that of the widest windows of likely atoms.
REACH = 2


@dataclass(frozen=True)
class PseudoSampleConstants:
    """How pseudo-samples are made and weighed.

    Errors are flat around these values: 32 or 128 unseen patterns, or a common error of 0.01 or
    0.04, change them by about a tenth (docs/few-patterns.md).
    """

    # Random patterns, never shown, under which rows are predicted.
    unseen: int = 64
    # Their seed. No user has it, so that none of them is shown by chance.
    seed: int = 0x5EED_0F_64
    # Standard deviation of a real sample, relative to the clip level. A pseudo-sample of standard
    # deviation d has the weight 1 / (1 + (d / deviation)^2).
    deviation: float = 0.0033
    # The least standard deviation of a pseudo-sample, relative to its value: neighbours err alike.
    common_error: float = 0.02
    # From this number of known samples of a row on, pseudo-samples weigh less, by its square: a
    # row's own information grows, but errors that neighbours share do not average out. In
    # proportion from 16 on, `gripper` at blur 2 and 32 patterns errs by .046 in place of .042.
    enough: int = 32
    # Pseudo-samples of less weight are left out. Chosen by hand.
    least_weight: float = 1e-4


@dataclass(frozen=True)
class LikelyAtomConstants:
    """How neighbours make atoms likely.

    `python -m benchmarks.ablation` measures what the rules are worth (docs/few-patterns.md).
    """

    # A spot makes the single pixels within it likely by this share of its own likelihood, in the
    # first round and later. It is small at first, as single pixels explain everything, noise as
    # well; later rounds doubt single pixels by the light that they hold.
    within_at_first: float = 0.04
    within: float = 0.5
    # A single pixel, or a spot, makes the next wider spot in its place likely by this factor:
    # several narrow spots are often one wider spot, which is cheaper.
    wider_pixel: float = 0.25
    wider_spot: float = 2.0
    # Single pixels count fully where they hold at least this share of the light around. Where they
    # hold less, they count by `pixels_power` of the proportion, at least `pixels_least`. After the
    # first round they hold a twentieth of the light where footprints are wide, from which they must
    # not grow, and a fifth or more where footprints are narrow.
    pixels_believed: float = 0.25
    pixels_power: int = 6
    pixels_least: float = 0.001
    # Side in camera pixels of the square that counts as around.
    pixels_around: int = 9
    # Neighbours must hold 1 + spread q^2 times as much of an atom, where the background holds the
    # share q of a row's light. Rows of mostly global light then err by 6 % less, others hardly
    # change.
    spread: float = 6.0


PSEUDO_SAMPLES = PseudoSampleConstants()
LIKELY_ATOMS = LikelyAtomConstants()


def unseen_patterns(shape: tuple[int, int]) -> PatternSet:
    """The patterns that were never shown."""
    return BernoulliPatterns(shape, PSEUDO_SAMPLES.unseen, seed=PSEUDO_SAMPLES.seed)


@dataclass(frozen=True)
class Neighbourhood:
    """All M rows after a round, on atoms and one background, and their Jacobian (M, 4).

    The rows are every `spacing`-th pixel of the `camera` (rows, columns, channels) along both axes.
    """

    rows: SparseRows
    camera: tuple[int, int, int]
    atoms: AtomPatterns
    spacing: int = 1
    known_jacobian: NDArray[np.float32] | None = None

    def around(self, start: int, stop: int) -> tuple[int, int]:
        """The range of rows that contains the neighbours of the rows start..stop."""
        _, cols, channels = self.camera
        reach = (REACH * cols + REACH) * channels
        return max(0, start - reach), min(self.rows.count, stop + reach)

    def pseudo_samples(
        self,
        unseen: PatternSet,
        samples: Samples,
        clipped: NDArray[np.bool_],
        level: float,
        rows: NDArray[np.int64],
        background: NDArray[np.float32],
    ) -> PseudoSamples:
        """Pseudo-samples of m ascending rows in place of clipped samples and under unseen patterns.

        `samples` are (m, K), `clipped` ones lower bounds; deviations are relative to `level`.
        `background` has those of the rows `around`, under K shown and E unseen patterns, (n, K +
        E).
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
        count, constants = self.atoms.count, PSEUDO_SAMPLES
        np.maximum(values[:, :count], samples.clip_level, out=values[:, :count], where=clipped)
        # 1 / (1 + (variance + (common_error value)^2) / (deviation level)^2), in place.
        weight = np.square(values)
        weight *= np.float32(constants.common_error**2)
        weight += variances
        weight /= np.float32((constants.deviation * level) ** 2)
        weight += 1
        np.reciprocal(weight, out=weight)
        weight[:, :count] *= clipped
        # Masked rows have no sample that counts. They stay empty.
        used = samples.counted
        known = (used & ~clipped).sum(axis=1, keepdims=True)
        helped = np.minimum(1, (constants.enough / np.maximum(known, 1)) ** 2)
        weight *= (helped * used.any(axis=1, keepdims=True)).astype(np.float32)
        weight[weight < constants.least_weight] = 0
        return PseudoSamples(unseen, values, weight)

    @property
    def projector(self) -> tuple[int, int, int]:
        """Planes, rows and columns of the atoms."""
        return self.atoms.planes, *self.atoms.shape

    @computed_once
    def jacobian(self) -> NDArray[np.float32]:
        """The Jacobian of the correspondence, (M, 4); see `measure_jacobian`."""
        if self.known_jacobian is not None:
            return self.known_jacobian
        return measure_jacobian(self.rows.coefficients, self.camera, self.atoms.shape, self.spacing)

    @computed_once
    def centres(self) -> csr_array:
        """The rows with the light of each spot at its centre, (M, N)."""
        return self.atoms.centres(self.rows.coefficients)

    @computed_once
    def singles(self) -> NDArray[np.float32]:
        """How far single pixels count, in [0, 1], by the light that they hold around, (M,)."""
        constants, rows = LIKELY_ATOMS, self.rows.coefficients
        single = np.where(rows.indices < self.atoms.single.pixels, rows.data, 0)
        pixels = csr_array((single, rows.indices, rows.indptr), shape=rows.shape)
        whole = rows.sum(axis=1).reshape(self.camera)
        part = pixels.sum(axis=1).reshape(self.camera)
        lit = whole > 0
        share = np.divide(part, whole, out=np.zeros(self.camera), where=lit)
        around = np.nan_to_num(mean_around(share, lit, constants.pixels_around))
        belief = (around / constants.pixels_believed) ** constants.pixels_power
        return np.clip(belief, constants.pixels_least, 1).astype(np.float32).ravel()

    def likely_atoms(
        self,
        reach: tuple[int, int],
        most: int,
        trust: float,
        known: NDArray[np.integer],
        rows: NDArray[np.int64],
        *,
        first: bool = False,
    ) -> Candidates:
        """The likeliest atoms of some ascending rows, with penalties by the light of neighbours.

        `reach` has half widths of the windows in camera and projector pixels, `most` limits a row's
        atoms, and `trust` is how little light among neighbours makes an atom likely for 32 `known`
        samples.
        """
        constants = LIKELY_ATOMS
        wider = np.full(self.atoms.planes, constants.wider_spot, np.float32)
        wider[0] = constants.wider_pixel
        indptr, atoms, penalties = _core.likely_pixels(
            self.rows.coefficients,
            self.camera,
            self.projector,
            self.jacobian,
            self.atoms.spots,
            constants.within_at_first if first else constants.within,
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
        """How far rows can do without neighbours, (m,); 1 with `enough` known samples.

        It is less with fewer samples for each pixel that a row may see: about as many pixels as
        footprints move by from one camera pixel to the next. It is more where most light is in the
        background, where faint light of single pixels probably belongs too.
        """
        step = self.jacobian[rows].astype(np.float64) / self.spacing
        size = np.maximum(np.hypot(step[:, 0], step[:, 2]), np.hypot(step[:, 1], step[:, 3]))
        enough = PSEUDO_SAMPLES.enough
        independence = np.clip(known, 1, enough) / enough / np.maximum(size, 1)
        return independence * (1 + LIKELY_ATOMS.spread * self._background_share[rows] ** 2)

    @computed_once
    def _background_share(self) -> NDArray[np.float64]:
        """Share of each row's light that its background holds, (M,)."""
        background = self.rows.background.sum(axis=1, dtype=np.float64)
        whole = background + np.asarray(self.rows.coefficients.sum(axis=1), np.float64).ravel()
        return np.divide(background, whole, out=np.zeros_like(whole), where=whole > 0)
