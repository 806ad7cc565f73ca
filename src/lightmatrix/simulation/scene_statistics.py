"""Statistics of a scene's matrix: direct share, sparsity, clipping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.thinning import ascending_in_rows
from lightmatrix.simulation.truth import Truth


def direct_share(truth: Truth) -> float:
    """Share of all light that met one surface only."""
    return float(truth.direct_data.sum(dtype=np.float64) / truth.matrix.sum())


def entries_for_energy(truth: Truth, share: float) -> NDArray[np.int64]:
    """For each row, how many of its largest entries hold the given share of its sum, (M,) int."""
    matrix = truth.matrix
    lengths = np.diff(matrix.indptr)
    row = np.repeat(np.arange(len(lengths)), lengths)
    sums = np.cumsum(ascending_in_rows(matrix), dtype=np.float64)
    ends = np.concatenate([[0.0], sums])[matrix.indptr]
    # Count the smallest entries that together hold less than the rest of the share.
    total = np.diff(ends)
    spare = sums - ends[row] <= (total - share * total)[row]
    return np.where(total > 0, lengths - np.bincount(row[spare], minlength=len(lengths)), 0)


def clipped_share(truth: Truth, exposures: tuple[float, ...], count: int = 32) -> list[float]:
    """Share of samples that clip under Bernoulli(0.5) patterns, for each exposure."""
    light = irradiance(truth.matrix, BernoulliPatterns(truth.projector_shape, count))
    return [float((exposure * light >= 1).mean()) for exposure in exposures]
