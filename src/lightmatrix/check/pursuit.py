"""Camera samples predicted from a few projector pixels, by cross-validation.

A camera pixel that sees a few projector pixels follows them from pattern to pattern. Orthogonal
matching pursuit (Pati et al. 1993) finds the pixels that correlate best in part of the frames, and
predicts what the sample should be under the other patterns. Frames never predict themselves, not
even through the choice of pixels: that is what judging the order of frames needs
(`frame_order.py`), and what the live rig asks after each frame.

Small projectors are searched whole, once a fold. On large ones the live rig follows many rows, and
correlates each frame once: the correlation over all folds but one is that over all folds minus that
over the one. Pixels are then chosen from a shortlist: the best ones, and the neighbours of the very
best, where most of what else a camera pixel sees lies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.pattern_set import PatternSet

# Each row is explained by three projector pixels, about the footprint of a focused camera pixel.
# Chosen by hand: 32 frames cannot support many more.
PROJECTOR_PIXELS = 3
# Projectors of up to 4096 pixels are searched whole; there the shortlist saves no time.
SEARCHED_WHOLE = 1 << 12
# A shortlist holds the best pixel of 256 out of 16384 groups of pixels, and the square of
# neighbours within 7 pixels of the very best one; within 15 for the neighbours of a row, which may
# see other pixels than the row itself. Chosen by hand; tests/check/test_pursuit.py holds
# predictions from shortlists against those from all pixels.
_LISTED, _GROUPS = 256, 1 << 14
_NEIGHBOURS, _NEIGHBOURS_OF_GROUP = 7, 15
# Correlations with all pixels take at most 256 MiB, or are of 64 rows, at a time when listing;
# chosen to stay small beside the frames.
_LISTING_BYTES, _MOST_ROWS = 256 << 20, 64
# Scores are raised at random by up to this share, so that chance decides between equal ones.
_TIE = 1e-3

# The frames that a fold learns from, and the patterns that it predicts.
Fold = tuple[NDArray[np.int64], NDArray[np.int64]]
Chooser = Callable[[NDArray[np.float32]], NDArray[np.int64]]


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
    group: int = 1,
    *,
    shortlist: bool = True,
) -> NDArray[np.float32]:
    """Predict m rows under each of K patterns from the frames of the other folds, (m, K).

    `values` (m, K) are samples less what all rows have in common, NaN for patterns without a frame.
    `scale` (N,) is that of `column_scale`. `fold` (K,) counts from 0; patterns of fold -1 are
    predicted from all frames. Rows come in groups of `group` neighbours in the image; with a
    `shortlist`, the others of a group look around the best pixel of its first one.
    """
    seen = np.isfinite(values[0])
    folds = [
        (np.flatnonzero(seen & (fold != p)), np.flatnonzero(fold == p)) for p in np.unique(fold)
    ]
    predicted = np.empty(values.shape, np.float32)
    if not shortlist or patterns.pixels <= SEARCHED_WHOLE:
        for train, held in folds:
            choose = _search_all(patterns, scale, train)
            predicted[:, held] = _pursue(patterns, values, train, held, choose)
        return predicted
    draw = np.random.default_rng(0)
    # Four drawings serve the rows by turns.
    raised = [scale * (1 + _TIE * draw.random(len(scale), np.float32)) for _ in range(4)]
    block = group * int(
        np.clip(_LISTING_BYTES // (4 * patterns.pixels * (len(folds) + 1)), 1, _MOST_ROWS)
    )
    reach = _NEIGHBOURS if group == 1 else _NEIGHBOURS_OF_GROUP
    for start in range(0, len(values), block):
        rows = values[start : start + block]
        scores = _scores_by_fold(patterns, rows[::group], folds)
        for (train, held), of_fold in zip(folds, scores, strict=True):
            listed = np.array(
                [
                    _best_listed(score * raised[row % 4], patterns.shape, reach)
                    for row, score in enumerate(of_fold)
                ]
            )
            choose = _search_listed(patterns, scale, listed, train)
            predicted[start : start + block, held] = _pursue(patterns, rows, train, held, choose)
    return predicted


def _pursue(
    patterns: PatternSet,
    values: NDArray[np.float32],
    train: NDArray[np.integer],
    held: NDArray[np.integer],
    choose: Chooser,
) -> NDArray[np.float32]:
    """Predict rows under the patterns `held` from the frames `train`, (m, len(held)).

    `choose` gives for residuals (m, len(train)) the pixel (m,) that correlates best with each.
    """
    mean = values[:, train].mean(axis=1, keepdims=True)
    centred = values[:, train] - mean
    residual = centred
    chosen = np.empty((len(values), 0), np.int64)
    for _ in range(PROJECTOR_PIXELS):
        chosen = np.column_stack([chosen, choose(residual)])
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
    return np.asarray(mean + (expected @ light)[..., 0], np.float32)


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


def _search_all(
    patterns: PatternSet, scale: NDArray[np.float32], train: NDArray[np.integer]
) -> Chooser:
    # If the first of equal pixels always won, all rows would agree on a prediction that nothing
    # supports. So each row prefers other ones.
    ties = 1 + _TIE * np.random.default_rng(0).random(2 * patterns.pixels, np.float32)

    def choose(residual: NDArray[np.float32]) -> NDArray[np.int64]:
        spread = np.zeros((len(residual), patterns.count), np.float32)
        spread[:, train] = residual
        return best_pixels(patterns, scale, spread, ties)

    return choose


def _search_listed(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    listed: NDArray[np.int64],
    train: NDArray[np.integer],
) -> Chooser:
    """Choose from the shortlist of a row's group, (groups, length)."""
    columns = patterns.at(listed)
    shown = np.ascontiguousarray(np.moveaxis(columns[train], 0, 1))

    def choose(residual: NDArray[np.float32]) -> NDArray[np.int64]:
        grouped = residual.reshape(len(listed), -1, residual.shape[1])
        scores = grouped @ shown * scale[listed][:, None]
        return np.take_along_axis(listed, scores.argmax(axis=2), axis=1).ravel()

    return choose


def _scores_by_fold(
    patterns: PatternSet, values: NDArray[np.float32], folds: list[Fold]
) -> Iterator[NDArray[np.float32]]:
    """Correlations (m, N) of rows with every projector pixel over the frames of each fold."""
    frames = np.flatnonzero(np.isfinite(values[0]))
    values = values - values[:, frames].mean(axis=1, keepdims=True)
    ones = np.ones((1, patterns.count), np.float32)
    own, own_of_one = {}, {}
    for k, (_, held) in enumerate(folds):
        tested = np.intersect1d(frames, held)
        if len(tested):
            own[k] = _correlations(patterns, values, tested)
            own_of_one[k] = _correlations(patterns, ones, tested)
    whole = reduce(np.add, own.values())
    for k, (train, _) in enumerate(folds):
        if k not in own:
            yield whole
            continue
        of_one = reduce(np.add, [each for j, each in own_of_one.items() if j != k])
        # The mean over the other frames is not that over all.
        yield whole - own[k] - values[:, train].mean(axis=1, keepdims=True) * of_one


def _correlations(
    patterns: PatternSet, values: NDArray[np.float32], frames: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Correlations of rows with every projector pixel over some frames, (m, N)."""
    bits = patterns.as_bits()
    if bits is not None:
        return np.asarray(BitPatterns(patterns.shape, bits[frames]).adjoint(values[:, frames]))
    only = np.zeros_like(values)
    only[:, frames] = values[:, frames]
    return np.asarray(patterns.adjoint(only))


def _best_listed(
    scores: NDArray[np.float32], shape: tuple[int, int], reach: int
) -> NDArray[np.int64]:
    """The shortlist of a row by its scores (N,): best pixels, and neighbours of the very best."""
    wanted = min(_LISTED, len(scores))
    groups = min(_GROUPS, len(scores))
    deep = -(-len(scores) // groups)
    padded = np.full(deep * groups, -np.inf, np.float32)
    padded[: len(scores)] = scores
    # Neighbours are in different groups.
    by_group = padded.reshape(deep, groups)
    best = np.argpartition(by_group.max(axis=0), groups - wanted)[groups - wanted :]
    pixels = by_group[:, best].argmax(axis=0) * groups + best
    row, col = np.unravel_index(pixels[scores[pixels].argmax()], shape)
    near = np.arange(-reach, reach + 1)
    rows, cols = np.clip(row + near, 0, shape[0] - 1), np.clip(col + near, 0, shape[1] - 1)
    neighbours = np.ravel_multi_index(np.ix_(rows, cols), shape).ravel()
    return np.concatenate([pixels, neighbours]).astype(np.int64)
