"""Where the patterns determine T: their inverse, and what lies below the noise is dark.

The noise is measured from entries below 0, which are noise alone. An entry stays if it is likelier
light than noise, by the share of the row that is dark: of a sparse row what exceeds about four
standard deviations, of a picture (a bucket detector under complete Hadamard patterns) everything.

These lose the share threshold / energy (the nonnegative garrote, Breiman 1995). Beside them,
entries stay where the camera pixels around see light of the same projector pixel, less the share of
noise in the mean energy of these (Wiener's filter). Of smooth scenes the error is then 1.0 to 1.1
times that of an oracle that knows which entries exceed the noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.estimators.automatic_regularization import default_regularization, spread_samples
from lightmatrix.estimators.base import Plan
from lightmatrix.estimators.certainty import with_certainty
from lightmatrix.estimators.plain import PlainEstimator, PlainRows
from lightmatrix.estimators.work import TILE_BYTES, Work, cut_rows
from lightmatrix.patterns.inverse import Floats, Inverse
from lightmatrix.progress import Progress
from lightmatrix.resources.threads import computed_once
from lightmatrix.solvers import solve
from lightmatrix.transport.checkpoint import Span
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class DirectEstimator(PlainEstimator):
    """Reads T from patterns that have an `inverse`; its regularization is the measured noise.

    Rows have the diagnostics clipped_share, only_bounded (whether an entry clipped) and
    estimated_error: the noise of what stays, and what remains of the rest beyond noise; NaN if
    hardly an entry is dark, so that the noise is unknown. Rows of sums that clip are solved.
    """

    name: ClassVar[str] = "direct"

    def plan(self, capture: Capture) -> Plan:
        """The estimate before it is made."""
        measured = replace(self, regularization=_Inverted(capture, self, 0.0).noise[0])
        return super(DirectEstimator, measured).plan(capture)

    def work(self, capture: Capture, regularization: float) -> Work:
        """The rows of a capture, in tiles."""
        return _Inverted(capture, self, regularization)


# Camera pixels at most so far apart count as neighbours: 5 x 5 of them. Of three bundled
# scenes under 24 lights, single pixels and Hadamard patterns, 3 x 3 erred by up to 7 % more.
_REACH = 2


class _Inverted(PlainRows):
    @property
    def inverse(self) -> Inverse:
        assert self.capture.patterns.inverted is not None
        return self.capture.patterns.inverted

    @computed_once
    def noise(self) -> tuple[float, bool]:
        """Standard deviation of a sample at exposure 1, and whether it was measured."""
        values, _ = spread_samples(self.capture)
        gains = self.inverse.gains
        entries = self.inverse.solve(values)[:, gains > 0] / gains[gains > 0]
        below = entries[entries < 0]
        # Fewer than one entry in a hundred may be faults. Where none is dark, noise is unknown.
        if len(below) < 0.01 * entries.size:
            return USUAL_NOISE * self.capture.reference_level, False
        # Sums that clip leave large entries, which do not move the median.
        usual = below[below > 8 * np.median(below)]
        return float(np.sqrt(np.mean(np.square(usual)))), True

    def tiles(self, step: str, parts: int = 1) -> Iterator[Span]:
        patterns = self.capture.patterns
        most = TILE_BYTES // (40 * (patterns.count + patterns.pixels))
        # The neighbours of a tile are read with it.
        least = 2 * _REACH * self._line
        return cut_rows(self.capture.rows, self.estimator.tile_rows or max(least, most), parts)

    @property
    def _line(self) -> int:
        """Camera samples of a line."""
        return self.capture.rows // self.capture.camera_shape[0]

    def _around(self, entries: Floats, variances: Floats) -> NDArray[np.float32]:
        """Wiener's weights of entries, of whole lines, where the pixels around see light; else 0.

        There, their mean energy exceeds the noise by four of its standard deviations, though each
        counts up to three of them: one bright pixel does not make others light.
        """
        cols, side = self.capture.camera_shape[1], 2 * _REACH + 1

        def mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
            image = values.reshape(-1, cols, self._line // cols, values.shape[1])
            box = np.full(side, 1 / side)
            for axis in (0, 1):
                image = scipy.ndimage.convolve1d(image, box, axis, mode="constant")
            return image.reshape(values.shape)

        squares, noise = np.square(entries, dtype=np.float32), variances.astype(np.float32)
        # Windows at the borders of the camera hold a smaller share of pixels.
        inside = mean(np.ones((len(entries), 1), np.float32))
        beyond = 1 + 4 * np.sqrt(2 / inside) / side
        lit = mean(np.minimum(squares, 9 * noise)) > noise * beyond * inside
        energy = np.maximum(mean(squares) / inside, np.finfo(np.float32).tiny)
        return np.asarray(lit * np.maximum(1 - noise / energy, 0))

    def _solve(self, start: int, stop: int, progress: Progress) -> SparseRows:
        line, total, patterns = self._line, self.capture.rows, self.capture.patterns
        first = max(0, start // line - _REACH) * line
        last = min(total, (-(-stop // line) + _REACH) * line)
        samples, own = self.capture.samples(first, last), slice(start - first, stop - first)
        entries, (noise, measured) = self.inverse.solve(samples.values), self.noise
        variances = np.square(noise * self.inverse.gains)
        unread = ~samples.counted if self.inverse.lone else samples.clipped | ~samples.counted
        entries[unread.any(axis=1)] = 0
        weights = (self._around(entries, variances) * measured)[own]
        samples, entries = samples.rows(own), entries[own]
        dark = 2 * np.mean(entries <= 0, axis=1, keepdims=True)
        dark = np.minimum(dark, 1 - 1 / entries.shape[1])
        # A dark pixel exceeds this many variances as seldom as a tenth of the pixels are light.
        least = 2 * np.log1p(10 * dark / (1 - dark)) * variances
        squares = np.square(entries)
        garrote = np.maximum(1 - least / np.maximum(squares, np.finfo(float).tiny), 0)
        weights = np.where(entries > 0, np.where(weights > 0, weights, garrote), 0)
        # What is missed of the light is what the dark entries have beyond their noise. Chance makes
        # this too much rather than too little.
        beyond = (squares - variances) * (weights == 0)
        missed = (weights * variances).sum(axis=1) + np.maximum(beyond.sum(axis=1), 0)
        entries *= weights
        lost = np.flatnonzero(unread[own].any(axis=1))
        background = np.zeros(len(entries), np.float32)
        if len(lost):
            # The penalty follows the noise alone, not the level of samples.
            penalty = default_regularization(patterns, 1e-9 * noise, noise)
            problem = self.estimator.problem(patterns, samples.rows(lost), penalty)
            solved = solve(problem, self.estimator.solver)
            entries[lost], background[lost] = solved.coefficients.toarray(), solved.background
            missed[lost] = np.nan
        length = np.linalg.norm(entries, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(measured & (length > 0), np.sqrt(missed) / length, np.nan)
        diagnostics = {
            "clipped_share": samples.clipped.mean(axis=1, dtype=np.float32),
            "only_bounded": np.float32(samples.clipped.any(axis=1) & self.inverse.lone),
            "estimated_error": error.astype(np.float32),
        }
        coefficients = scipy.sparse.csr_array(entries.astype(np.float32))
        rows = SparseRows(coefficients, background[:, None], diagnostics)
        progress(len(entries), len(entries))
        return with_certainty(rows, samples, patterns, start, total)
