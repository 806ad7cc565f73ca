"""Camera samples predicted from a few projector pixels, by cross-validation.

A camera pixel that sees a few projector pixels follows them from pattern to pattern. Orthogonal
matching pursuit (Pati et al. 1993) finds the pixels that correlate best in part of the frames, and
predicts what the sample should be under the other patterns. Frames never predict themselves, not
even through the choice of pixels: that is what judging the order of frames needs
(`frame_order.py`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.pattern_set import PatternSet

# Each row is explained by three projector pixels, about the footprint of a focused camera pixel.
# Chosen by hand: 32 frames cannot support many more.
PROJECTOR_PIXELS = 3
# Scores are raised at random by up to this share, so that chance decides between equal ones.
_TIE = 1e-3


def fold_count(frames: int) -> int:
    """The number of folds for cross-validation; few frames can spare only few at a time."""
    return 8 if frames <= 64 else 4 if frames < 128 else 2


def column_scale(patterns: PatternSet) -> NDArray[np.float32]:
    """One over the standard deviation of each projector pixel over the patterns; 0 if constant."""
    mean = patterns.weighted_sum(np.full(patterns.count, 1 / patterns.count))
    variance = patterns.squares / patterns.count - mean**2
    scale = np.zeros(patterns.pixels, np.float32)
    varied = variance > 1e-6
    scale[varied] = 1 / np.sqrt(variance[varied])
    return scale


def predict_by_pursuit(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    values: NDArray[np.float32],
    fold: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Predict m rows under each of K patterns from the frames of the other folds, (m, K).

    `values` (m, K) are samples less what all rows have in common, NaN for patterns without a frame.
    `scale` (N,) is that of `column_scale`. `fold` (K,) counts from 0; patterns of fold -1 are
    predicted from all frames.
    """
    seen = np.isfinite(values[0])
    predicted = np.empty(values.shape, np.float32)
    # If the first of equal pixels always won, all rows would agree on a prediction that nothing
    # supports. So each row prefers other ones.
    ties = 1 + _TIE * np.random.default_rng(0).random(2 * patterns.pixels, np.float32)
    for part in np.unique(fold):
        train, held = np.flatnonzero(seen & (fold != part)), np.flatnonzero(fold == part)
        mean = values[:, train].mean(axis=1, keepdims=True)
        centred = values[:, train] - mean
        residual = centred
        chosen = np.empty((len(values), 0), np.int64)
        for _ in range(PROJECTOR_PIXELS):
            spread = np.zeros(values.shape, np.float32)
            spread[:, train] = residual
            chosen = np.column_stack([chosen, best_pixels(patterns, scale, spread, ties)])
            columns = patterns.at(chosen)
            shown = columns[train]
            level = shown.mean(axis=0)
            basis = np.moveaxis(shown - level, 0, 1)
            gram = basis.transpose(0, 2, 1) @ basis
            # Pixels chosen twice, or alike, share their light.
            ridge = 1e-4 * np.trace(gram, axis1=1, axis2=2) + 1e-6
            gram += ridge[:, None, None] * np.eye(chosen.shape[1], dtype=gram.dtype)
            light = np.linalg.solve(gram, basis.transpose(0, 2, 1) @ centred[..., None])
            residual = centred - (basis @ light)[..., 0]
        expected = np.moveaxis(columns[held] - level, 0, 1)
        predicted[:, held] = mean + (expected @ light)[..., 0]
    return predicted


def best_pixels(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    residual: NDArray[np.floating],
    ties: NDArray[np.float32] | None = None,
) -> NDArray[np.int64]:
    """The projector pixel that correlates best with each row of residuals (m, K), (m,).

    Scores are multiplied by `ties` (2 N,), from another one on in each row.
    """

    def best_of(rows: slice, pixels: slice, scores: NDArray[np.float32]) -> tuple[Any, ...]:
        scores *= scale[pixels]
        if ties is not None:
            for row, score in enumerate(scores, rows.start):
                first = row * 7919 % patterns.pixels
                score *= ties[first:][pixels]
        found = scores.argmax(axis=1)
        return rows, found + pixels.start, np.take_along_axis(scores, found[:, None], axis=1)[:, 0]

    best = np.zeros(len(residual), np.int64)
    highest = np.full(len(residual), -np.inf, np.float32)
    for rows, found, score in patterns.correlations(residual.astype(np.float32), best_of):
        better = score > highest[rows]
        best[rows] = np.where(better, found, best[rows])
        highest[rows] = np.maximum(score, highest[rows])
    return best
