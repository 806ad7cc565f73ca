"""What the rows around a row say of it: which atoms it probably holds, and its pseudo-samples.

Neighbouring camera pixels have much the same footprint, moved by a pixel or so. How it moves is the
Jacobian of the correspondence: among the displacements between the strongest pixels of neighbours
the true one is a peak, however many rows are wrong. Moved back by it, a neighbour's light makes
atoms likely, and its row is a guess at this one's samples. The pseudo-samples are the mean of these
guesses. They stand in for clipped samples and for patterns never shown (`docs/coherent.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import computed_once
from lightmatrix.solvers.active_set import Candidates, PseudoSamples
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class JacobianConstants:
    """How the Jacobian is measured; all values are chosen by hand.

    Together they find it to a fiftieth of a pixel (`tests/estimators/test_correspondence.py`).
    """

    # The longest displacement between neighbours that is counted, in projector pixels.
    fastest: int = 12
    # The largest distance in camera pixels over which displacements are counted for the whole
    # frame. It starts at 1 and doubles: the longer, the finer the mean Jacobian.
    farthest: int = 16
    # A displacement in projector pixels that is long enough; the distance grows no further.
    long: int = 8
    # The peak at a distance lies this close to the one predicted from half the distance, in
    # projector pixels per camera pixel.
    nearby: float = 0.75
    # Camera pixels to both sides between which the local Jacobian is measured.
    step: int = 2
    # Side of the square of camera pixels whose median is the local Jacobian.
    window: int = 9
    # A local displacement is an outlier if it differs from that of the whole frame by more than
    # this many times its length: a row is wrong, or a depth edge lies between.
    unlike: float = 2.0
    # Medians of displacements of whole pixels are coarse. The final value is the mean, over a
    # square of this side, of the displacements within the distance `alike` of the median.
    finer_window: int = 15
    alike: float = 0.5


JACOBIAN = JacobianConstants()


def measure_jacobian(
    rows: csr_array, camera: tuple[int, int, int], projector: tuple[int, int], spacing: int = 1
) -> NDArray[np.float32]:
    """How footprints move per camera row and column, (M, 4), in projector rows and columns.

    `rows` are coefficients of atoms, S planes of N pixels, (M, S N), `spacing` camera pixels apart.
    The result is rows by rows, rows by columns, columns by rows, columns by columns.
    """
    pixel = strongest_entries(rows) % (projector[0] * projector[1])
    places = [place.reshape(camera) for place in np.divmod(pixel, projector[1])]
    lit = (np.diff(rows.indptr) > 0).reshape(camera)
    result = np.empty((*camera, 4), np.float32)
    for axis in (0, 1):
        usual = _frame_displacement(places, lit, axis, JACOBIAN.fastest * spacing)
        # Differences per pixel, between `step` pixels to both sides.
        index = np.arange(camera[axis])
        before = np.maximum(index - JACOBIAN.step, 0)
        after = np.minimum(index + JACOBIAN.step, camera[axis] - 1)
        distance = np.maximum(after - before, 1).reshape(-1, *[1] * (2 - axis))
        steps = (place.take(after, axis) - place.take(before, axis) for place in places)
        slopes = [(each / distance).astype(np.float32) for each in steps]
        off = np.hypot(slopes[0] - usual[0], slopes[1] - usual[1])
        outliers = (off > JACOBIAN.unlike * max(1.0, float(np.hypot(*usual)))) | ~lit
        for i in (0, 1):
            slope = np.where(outliers, np.float32(usual[i]), slopes[i])
            size = (JACOBIAN.window, JACOBIAN.window, 1)
            median = scipy.ndimage.median_filter(slope, size=size, mode="nearest")
            alike = np.abs(slope - median) <= JACOBIAN.alike
            finer = mean_around(slope, alike, JACOBIAN.finer_window)
            result[..., 2 * i + axis] = np.where(np.isnan(finer), median, finer)
    return result.reshape(-1, 4)


def strongest_entries(rows: csr_array) -> NDArray[np.int64]:
    """The column of the strongest entry of each row, (M,); the last of equal ones, 0 if empty."""
    entries = np.diff(rows.indptr)
    result = np.zeros(len(entries), np.int64)
    lit = np.flatnonzero(entries)
    if len(lit):
        most = np.maximum.reduceat(rows.data, rows.indptr[lit])
        strong = np.flatnonzero(rows.data == np.repeat(most, entries[lit]))
        # NumPy writes equal ones in order, so that the last one stays.
        result[np.repeat(np.arange(len(entries)), entries)[strong]] = rows.indices[strong]
    return result


def _frame_displacement(
    places: list[NDArray[np.int64]], lit: NDArray[np.bool_], axis: int, fastest: int
) -> tuple[float, float]:
    """The commonest displacement per camera pixel along an axis; (0, 0) where there is none."""
    length = lit.shape[axis]
    mean = (0.0, 0.0)
    distance = 1
    while distance <= min(JACOBIAN.farthest, length - 1):
        here, there = np.arange(length - distance), np.arange(distance, length)
        both = lit.take(here, axis) & lit.take(there, axis)
        steps = [(place.take(there, axis) - place.take(here, axis))[both] for place in places]
        predicted = [round(part * distance) for part in mean]
        reach = fastest if distance == 1 else max(3, int(np.ceil(JACOBIAN.nearby * distance)))
        peak = _commonest([s - p for s, p in zip(steps, predicted, strict=True)], reach)
        if peak is None:
            break
        sizes = [p + offset for p, offset in zip(predicted, peak, strict=True)]
        mean = (sizes[0] / distance, sizes[1] / distance)
        if max(map(abs, sizes)) >= JACOBIAN.long:
            break
        distance *= 2
    return mean


def _commonest(steps: list[NDArray[np.int64]], reach: int) -> tuple[float, float] | None:
    """The centre of the commonest 3 x 3 displacements, none longer than `reach`; None if none."""
    side = 2 * reach + 1
    near = (np.abs(steps[0]) <= reach) & (np.abs(steps[1]) <= reach)
    if not near.any():
        return None
    flat = (steps[0][near] + reach) * side + steps[1][near] + reach
    counts = np.bincount(flat, minlength=side * side).reshape(side, side).astype(np.float64)
    sums = scipy.ndimage.uniform_filter(counts, 3, mode="constant")
    r, c = np.unravel_index(int(sums.argmax()), sums.shape)
    around = np.pad(counts, 1)[r : r + 3, c : c + 3]
    down, right = np.mgrid[-1:2, -1:2]
    place = [float((around * each).sum() / around.sum()) for each in (down, right)]
    return place[0] + int(r) - reach, place[1] + int(c) - reach


# Camera samples that are read at a time to pick those on the grid. Chosen by hand: their frames fit
# into memory many times.
_READ_ROWS = 1 << 16


@dataclass(frozen=True, eq=False)
class CameraGrid:
    """Every `spacing`-th pixel of a camera along both axes."""

    capture: Capture
    spacing: int = 1

    @property
    def camera(self) -> tuple[int, int, int]:
        """Rows, columns and channels of the grid."""
        rows, cols, *channels = self.capture.camera_shape
        return -(-rows // self.spacing), -(-cols // self.spacing), channels[0] if channels else 1

    @property
    def count(self) -> int:
        """Number of samples on the grid."""
        rows, cols, channels = self.camera
        return rows * cols * channels

    def samples(self, start: int, stop: int) -> Samples:
        """Samples start..stop of the grid."""
        if self.spacing == 1:
            return self.capture.samples(start, stop)
        return self._all.rows(slice(start, stop))

    def spread(self, coarser: CameraGrid, rows: SparseRows) -> SparseRows:
        """The rows of a coarser grid in their places on this one, with empty rows between."""
        place = coarser._places(self)
        entries = np.zeros(self.count, np.int64)
        entries[place] = np.diff(rows.coefficients.indptr)
        ends = np.append(0, np.cumsum(entries)).astype(rows.coefficients.indptr.dtype)
        parts = rows.coefficients.data, rows.coefficients.indices, ends
        background = np.zeros((self.count, rows.background.shape[1]), rows.background.dtype)
        background[place] = rows.background
        diagnostics = {}
        for name, values in rows.diagnostics.items():
            diagnostics[name] = np.zeros(self.count, values.dtype)
            diagnostics[name][place] = values
        shape = (self.count, rows.coefficients.shape[1])
        return SparseRows(csr_array(parts, shape=shape), background, diagnostics)

    def refine_jacobian(
        self, coarser: CameraGrid, jacobian: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The Jacobian per pixel of this grid, (M', 4), from that of a coarser grid."""
        times = coarser.spacing // self.spacing
        rows, cols, channels = self.camera
        each = (jacobian / times).reshape(*coarser.camera, 4).astype(np.float32)
        finer = each.repeat(times, axis=0).repeat(times, axis=1)[:rows, :cols]
        return np.ascontiguousarray(finer).reshape(rows * cols * channels, 4)

    def _places(self, finer: CameraGrid) -> NDArray[np.int64]:
        """The numbers of these samples among those of a finer grid."""
        rows, cols, channels = finer.camera
        index = np.arange(rows * cols * channels).reshape(rows, cols, channels)
        times = self.spacing // finer.spacing
        return index[::times, ::times].ravel()

    @computed_once
    def _all(self) -> Samples:
        """All samples on the grid, which are picked from those of the camera once."""
        whole = CameraGrid(self.capture)
        places = self._places(whole)
        parts = []
        for start in range(0, whole.count, _READ_ROWS):
            stop = min(start + _READ_ROWS, whole.count)
            first, last = np.searchsorted(places, (start, stop))
            if first < last:
                parts.append(self.capture.samples(start, stop).rows(places[first:last] - start))
        return Samples.joined(parts)


def mean_around(image: NDArray[Any], known: NDArray[np.bool_], side: int) -> NDArray[np.float64]:
    """Means of the known values in squares around pixels, (rows, cols, channels), or NaN."""
    window = (side, side, 1)
    filled = np.where(known, image, 0).astype(np.float64)
    sums = scipy.ndimage.uniform_filter(filled, window, mode="nearest")
    shares = scipy.ndimage.uniform_filter(known.astype(np.float64), window, mode="nearest")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(shares > 1e-9, sums / shares, np.nan)


# Half width, in camera pixels, of the window of neighbours that guess a row's samples. Chosen by
# hand: it is that of the widest windows of likely atoms.
REACH = 2


@dataclass(frozen=True)
class PseudoSampleConstants:
    """How pseudo-samples are made and weighed.

    Errors are flat around these values: 32 or 128 unseen patterns, or a common error of 0.01 or
    0.04, change them by about a tenth (docs/coherent.md).
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
    # proportion from 16 on, `gripper` at blur 2 and 32 patterns errs by 0.046 in place of 0.042.
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
    # A single pixel, or a spot, makes the next wider spot in its place likely by this factor, as
    # several narrow spots are often one wider spot. Without it metal at a blur of 2 pixels errs by
    # 0.057 in place of 0.038 (64 x 64, 64 patterns).
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
    # The Jacobians of each projector, if they are known; else they are measured.
    known_jacobians: Sequence[NDArray[np.float32]] = ()
    # Their pixels stand one above the other among the atoms.
    projectors: int = 1

    def around(self, start: int, stop: int) -> tuple[int, int]:
        """The range of rows that contains the neighbours of the rows start..stop."""
        _, cols, channels = self.camera
        reach = (REACH * cols + REACH) * channels
        return max(0, start - reach), min(self.rows.count, stop + reach)

    def part(self, rows: NDArray[np.int64], reach: int) -> tuple[Neighbourhood, NDArray[np.int64]]:
        """The camera pixels within a reach of some rows, and the rows' numbers among them."""
        row, col, channel = np.unravel_index(rows, self.camera)
        down, right = (
            np.arange(max(0, int(place.min()) - reach), min(side, int(place.max()) + reach + 1))
            for place, side in zip((row, col), self.camera[:2], strict=True)
        )
        around = np.ix_(down, right, np.arange(self.camera[2]))
        index = np.ravel_multi_index(around, self.camera)
        own = np.ravel_multi_index((row - down[0], col - right[0], channel), index.shape)
        known = [self.jacobian[index.ravel()]]
        near = replace(
            self, rows=self.rows.rows(index.ravel()), camera=index.shape, known_jacobians=known
        )
        return near, own

    def pseudo_samples(
        self, unseen: PatternSet, samples: Samples, clipped: NDArray[np.bool_], level: float,
        rows: NDArray[np.int64], background: NDArray[np.float32],
    ) -> PseudoSamples:  # fmt: skip
        """Pseudo-samples of m ascending rows in place of clipped samples and under unseen patterns.

        `samples` are (m, K), `clipped` ones lower bounds; deviations are relative to `level`.
        `background` has those of the rows `around`, under K shown and E unseen patterns, (n, K +
        E).
        """
        known = replace(samples, clipped=clipped)
        values, variances = self._expected(unseen, known, level, rows, background)
        count, constants = self.atoms.count, PSEUDO_SAMPLES
        np.maximum(values[:, :count], samples.clip_level, out=values[:, :count], where=clipped)
        # Neighbours estimated from fewer than twelve photographs err more than they differ. At 8
        # `gripper` errs by 0.027 in place of 0.038, `l_objects` by 0.039 in place of 0.047.
        deviation = constants.deviation * min(1.0, count / 12) ** 2
        # 1 / (1 + (variance + (common_error value)^2) / (deviation level)^2), in place.
        weight = np.square(values)
        weight *= np.float32(constants.common_error**2)
        weight += variances
        weight /= np.float32((deviation * level) ** 2)
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

    def _expected(
        self, unseen: PatternSet, samples: Samples, level: float, rows: NDArray[np.int64],
        background: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
        """Samples that neighbours expect of some rows, and their variances, (m, K + E)."""
        if self.projectors == 1:
            start, prepared = int(rows[0]), (self.atoms.prepared, unseen.prepared)
            return _core.expected_samples(
                *prepared, samples, self, background,
                reach=REACH, start=start, level=level, index=rows - start,
            )  # fmt: skip
        first, last = self.around(int(rows[0]), int(rows[-1]) + 1)
        own = background[rows - first, : self.atoms.count]
        # The background is divided among the projectors as their light is.
        light = [part.rows.coefficients.sum(axis=1, dtype=np.float32) for part in self.parts]
        total = np.maximum(np.sum(light, axis=0), np.float32(1e-30))
        shares = [(one / total)[:, None] for one in light]
        parts = list(zip(self.parts, shares, strict=True))
        shown = [part.under_patterns[rows] + share[rows] * own for part, share in parts]
        whole, expected = np.sum(shown, axis=0), []
        for (part, share), mine in zip(parts, shown, strict=True):
            # A projector explains what the others leave of the samples.
            left = replace(samples, values=samples.values - (whole - mine))
            around = background * share[first:last]
            expected.append(part._expected(unseen, left, level, rows, around))
        values, variances = (np.stack(each) for each in zip(*expected, strict=True))
        # A projector of which no neighbour holds light gives none.
        empty = np.isinf(variances)
        variances = np.where(empty.all(axis=0), np.inf, np.where(empty, 0, variances).sum(axis=0))
        return values.sum(axis=0), variances.astype(np.float32)

    @computed_once
    def parts(self) -> list[Neighbourhood]:
        """The light of each projector by itself."""
        if self.projectors == 1:
            return [self]
        result = []
        for number in range(self.projectors):
            rows = replace(self.rows, coefficients=self._of(number, self.rows.coefficients))
            known = self.known_jacobians[number : number + 1]
            result.append(replace(self, rows=rows, known_jacobians=known, projectors=1))
        return result

    @computed_once
    def _moving(self) -> list[Neighbourhood]:
        """The light of all projectors, moving as that of each does."""
        return [replace(self, known_jacobians=[part.jacobian], projectors=1) for part in self.parts]

    def _of(self, number: int, matrix: csr_array) -> csr_array:
        """The entries of a matrix of atoms (m, S N) that belong to a projector."""
        pixels = self.atoms.single.pixels
        own = csr_array(matrix, copy=True)
        own.data[matrix.indices % pixels // (pixels // self.projectors) != number] = 0
        own.eliminate_zeros()
        return own

    @computed_once
    def under_patterns(self) -> NDArray[np.float32]:
        """Samples of all rows under the patterns shown, without backgrounds, (M, K)."""
        chunks = [self.rows.coefficients @ chunk.T for _, chunk in self.atoms.chunks()]
        return np.concatenate(chunks, axis=1, dtype=np.float32)

    @property
    def projector(self) -> tuple[int, int, int]:
        """Planes, rows and columns of the atoms."""
        return self.atoms.planes, *self.atoms.shape

    @computed_once
    def jacobian(self) -> NDArray[np.float32]:
        """The Jacobian of the correspondence, (M, 4); see `measure_jacobian`."""
        if self.known_jacobians:
            return self.known_jacobians[0]
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
        self, reach: tuple[int, int], most: int, trust: float, known: NDArray[np.integer],
        rows: NDArray[np.int64], *, first: bool = False,
    ) -> Candidates:  # fmt: skip
        """The likeliest atoms of some ascending rows, with penalties by the light of neighbours.

        `reach` has half widths of the windows in camera and projector pixels, `most` limits a row's
        atoms of each projector, and `trust` is how little light among neighbours makes an atom
        likely for 32 `known` samples.
        """
        constants = LIKELY_ATOMS
        if self.projectors > 1:
            shape = (len(rows), self.atoms.pixels)
            several = csr_array(shape, dtype=np.float32)
            for number, one in enumerate(self._moving):
                found = one.likely_atoms(reach, most, trust, known, rows, first=first)
                matrix = csr_array((found.data, found.indices, found.indptr), shape=shape)
                several = several + self._of(number, matrix)
            return Candidates(several.indptr.astype(np.int64), several.indices, several.data)
        wider = np.full(self.atoms.planes, constants.wider_spot, np.float32)
        wider[0] = constants.wider_pixel
        # With `enough` known samples a row can do without neighbours. It is less with fewer samples
        # for each pixel that it may see: about as many pixels as footprints move by from one camera
        # pixel to the next.
        step = self.jacobian[rows].astype(np.float64) / self.spacing
        size = np.maximum(np.hypot(step[:, 0], step[:, 2]), np.hypot(step[:, 1], step[:, 3]))
        enough = PSEUDO_SAMPLES.enough
        independence = np.clip(known, 1, enough) / enough / np.maximum(size, 1)
        indptr, atoms, penalties = _core.likely_pixels(
            self.rows.coefficients, self.camera, self.projector, self.jacobian, self.atoms.spots,
            constants.within_at_first if first else constants.within, wider,
            np.ones(self.rows.count, np.float32) if first else self.singles, reach, most,
            trust * independence, (0, self.rows.count), rows,
        )  # fmt: skip
        return Candidates(indptr, atoms, penalties)
