"""Where the patterns determine T: their inverse, and what lies below the noise is dark.

The noise is measured from entries below 0, which are noise alone. An entry stays if it is likelier
light than noise, by the share of the row that is dark: of a sparse row what exceeds about four
standard deviations, of a picture (a bucket detector under complete Hadamard patterns) everything.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.estimators.automatic_regularization import default_regularization, spread_samples
from lightmatrix.estimators.base import Plan
from lightmatrix.estimators.certainty import with_certainty
from lightmatrix.estimators.plain import PlainEstimator, PlainRows
from lightmatrix.estimators.work import TILE_BYTES, Work, cut_rows
from lightmatrix.patterns.inverse import Inverse
from lightmatrix.resources.threads import computed_once
from lightmatrix.solvers import solve
from lightmatrix.solvers.loop import Progress
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
        return cut_rows(self.capture.rows, self.estimator.tile_rows or max(1, most), parts)

    def _solve(self, start: int, stop: int, progress: Progress) -> SparseRows:
        samples, patterns = self.capture.samples(start, stop), self.capture.patterns
        entries, (noise, measured) = self.inverse.solve(samples.values), self.noise
        variances = np.square(noise * self.inverse.gains)
        dark = 2 * np.mean(entries <= 0, axis=1, keepdims=True)
        dark = np.minimum(dark, 1 - 1 / entries.shape[1])
        # A dark pixel exceeds this many variances as seldom as a tenth of the pixels are light.
        least = 2 * np.log1p(10 * dark / (1 - dark)) * variances
        kept = (entries > 0) & (np.square(entries) > least)
        # What is missed of the light is what the dark entries have beyond their noise. Chance makes
        # this too much rather than too little.
        beyond = (np.square(entries) - variances) * ~kept
        missed = (kept * variances).sum(axis=1) + np.maximum(beyond.sum(axis=1), 0)
        entries *= kept
        clipped, known = samples.clipped.any(axis=1), samples.counted.all(axis=1)
        lost = np.flatnonzero((clipped & (not self.inverse.lone)) | ~known)
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
            "only_bounded": (clipped & self.inverse.lone).astype(np.float32),
            "estimated_error": error.astype(np.float32),
        }
        coefficients = csr_array(entries.astype(np.float32))
        rows = SparseRows(coefficients, background[:, None], diagnostics)
        progress(len(entries), len(entries))
        return with_certainty(rows, samples, patterns, start, self.capture.rows)
