"""Rows that are pictures, as of a bucket detector: least total variation, told by frames held out.

The solver is `lightmatrix.solvers.total_variation`. Its regularization is the one that predicts
photographs held out best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.automatic_regularization import column_length
from lightmatrix.estimators.coherent.row_errors import held_out_frames, squared_misfit
from lightmatrix.estimators.plain import PlainEstimator, PlainRows
from lightmatrix.estimators.work import Work
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers import solve
from lightmatrix.solvers.loop import Progress
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class PictureEstimator(PlainEstimator):
    """Estimates rows of least total variation.

    Rows have the diagnostic estimated_error, from photographs held out; NaN where none can be.
    """

    name: ClassVar[str] = "pictures"

    def work(self, capture: Capture, regularization: float) -> Work:
        """The rows of a capture, in tiles."""
        return _Pictures(capture, self, regularization)

    def fitted(self, capture: Capture) -> PictureEstimator:
        """The same with the regularization that predicts frames held out best."""
        if self.regularization is not None:
            return self
        # Sixteen rows, evenly spread, tell how strong the penalty should be.
        rows = np.linspace(0, capture.rows - 1, min(capture.rows, 16)).astype(int)
        some = Samples.joined([capture.samples(int(row), int(row) + 1) for row in rows])
        patterns = capture.patterns
        unit = float(some.values.std()) * column_length(patterns)
        unit = max(unit * np.sqrt(patterns.pixels / patterns.count), 1e-12)
        # On four pictures of 64 x 64 under a quarter of the Hadamard patterns, 0.003 to 0.03 of
        # this unit is best.
        tried = [replace(self, regularization=unit * share) for share in np.geomspace(0.1, 1e-3, 5)]
        missed = [float(np.nan_to_num(missed_by(each, patterns, some)).sum()) for each in tried]
        return tried[int(np.argmin(missed))] if any(missed) else tried[2]


def missed_by(
    estimator: PlainEstimator, patterns: PatternSet, samples: Samples
) -> NDArray[np.float32]:
    """Variances of the misfit of rows at frames held out, (m,); NaN if none can be."""
    judged = held_out_frames(patterns.count)
    if not len(judged):
        return np.full(samples.count, np.nan, np.float32)
    # A pattern whose inverse is shown, as single-pixel cameras do, would follow from that one.
    gram = patterns.gram - patterns.pixels * np.outer(patterns.means, patterns.means)
    contrast = np.diag(gram)
    alike = gram[:, judged] ** 2 > 0.99 * np.outer(contrast, contrast[judged])
    alike[judged] = True
    rest = np.flatnonzero(~alike.any(axis=1))
    assert estimator.regularization is not None
    problem = estimator.problem(
        patterns.subset(rest), samples.frames(rest), estimator.regularization
    )
    made, shown = solve(problem, estimator.solver), patterns.subset(judged)
    predicted = shown.forward(made.coefficients.toarray().astype(np.float32))
    predicted += np.outer(made.background, shown.means).astype(np.float32)
    return squared_misfit(samples, predicted, judged)


class _Pictures(PlainRows):
    def _solve(self, start: int, stop: int, progress: Progress) -> SparseRows:
        rows = super()._solve(start, stop, progress)
        patterns, samples = self.capture.patterns, self.capture.samples(start, stop)
        fitted = replace(self.estimator, regularization=self.regularization)
        missed = missed_by(fitted, patterns, samples)
        # An error of the row of this length has this variance under a pattern (`row_errors`).
        variance = column_length(patterns) ** 2 / patterns.count
        length = np.sqrt(rows.coefficients.power(2).sum(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt(missed / variance) / length
        # No pattern tells these apart, however well others are predicted.
        if patterns.alike_surroundings.mean() > 0.2:
            error[:] = np.nan
        error = error.astype(np.float32)
        return replace(rows, diagnostics={**rows.diagnostics, "estimated_error": error})
