"""Every pattern predicted from the frames of the others, in one look through all projector pixels.

As `predicted_samples` does part by part (cross-validation), but the correlation of a row with a
projector pixel over all parts but one is that over all less that over the one. So each frame is
correlated once, and pixels are chosen from a shortlist: those that correlate best, and the
neighbours of the very best, since what else a camera pixel sees is mostly there. What a part held
has no say in its own shortlist.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.prediction import predicted_samples, pursued
from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.pattern_set import PatternSet

# Pixels of a shortlist: of each of so many groups of pixels, only the best can be on it.
_LISTED, _GROUPS = 256, 1 << 14
# Neighbours to each side, for rows that are looked for and for rows beside them.
_AROUND, _BESIDE = 7, 15
# Projectors of fewer pixels are looked through for each part, which is as quick.
FEW = 1 << 12
_CORRELATION_BYTES = 256 << 20
_MOST_ROWS = 64
# Drawings of lots; rows in turn use them.
_LOTS = 4


def cross_predicted(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    values: NDArray[np.float32],
    taken: NDArray[np.int64],
    part: NDArray[np.int64],
    beside: int = 1,
) -> NDArray[np.float32]:
    """What each row should show under each pattern, from the frames of other parts.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    scale : (N,) float32
        See `column_scale`.
    values : (m, K) float32
        Samples, of each frame what all rows have in common taken off; only `taken` is looked at.
    taken : (k,) int
        The frames that there are.
    part : (k,) int
        The part of each, from 0 on.
    beside : int
        Rows come in groups of so many neighbours in the image. Where projectors are large, only
        the first of a group is looked for among all pixels, the others near to where it was found.

    Returns
    -------
    (m, K) float32
        Of patterns without a frame, from all frames.
    """
    parts = int(part.max()) + 1
    order = np.arange(patterns.count)
    predicted = np.empty((len(values), patterns.count), np.float32)
    looks = [(taken[part != p], taken[part == p]) for p in range(parts)]
    missing = np.setdiff1d(order, taken)
    if patterns.pixels <= FEW:
        if len(missing):
            looks.append((taken, missing))
        for train, held in looks:
            predicted[:, held] = predicted_samples(patterns, scale, values, order, train, held)
        return predicted
    first = values[::beside]
    first = first - first[:, taken].mean(axis=1, keepdims=True)
    ones = np.ones((1, patterns.count), np.float32)
    sums = [_correlated(patterns, ones, held)[0] for _, held in looks]
    totals = [reduce(np.add, sums[:p] + sums[p + 1 :]) for p in range(parts)]
    # Pixels that no frame tells apart are chosen between by lot.
    draw = np.random.default_rng(0)
    weights = [scale * (1 + 1e-3 * draw.random(len(scale), np.float32)) for _ in range(_LOTS)]
    block = int(np.clip(_CORRELATION_BYTES // (4 * patterns.pixels * (parts + 1)), 1, _MOST_ROWS))
    around = _AROUND if beside == 1 else _BESIDE
    for start in range(0, len(first), block):
        looked_for = first[start : start + block]
        some = slice(beside * start, beside * (start + block))
        each = [_correlated(patterns, looked_for, held) for _, held in looks]
        whole = reduce(np.add, each)
        jobs: list[tuple[NDArray[np.int64], NDArray[np.int64], Iterable[NDArray[np.float32]]]] = [
            (train, held, _without(whole, own, looked_for[:, train].mean(axis=1), total))
            for (train, held), own, total in zip(looks, each, totals, strict=True)
        ]
        if len(missing):
            jobs.append((taken, missing, whole))
        for train, held, scores in jobs:
            listed = np.array(
                [
                    _best(score * weights[row % _LOTS], patterns.shape, around)
                    for row, score in enumerate(scores)
                ]
            )
            best_pixels = _chooser(patterns, scale, listed, train)
            predicted[some, held] = pursued(patterns, values[some], order, train, held, best_pixels)
    return predicted


def _correlated(
    patterns: PatternSet, values: NDArray[np.float32], frames: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Correlations of rows with every projector pixel over some frames, (m, N)."""
    bits = patterns.as_bits()
    if bits is not None:
        return np.asarray(BitPatterns(patterns.shape, bits[frames]).adjoint(values[:, frames]))
    only = np.zeros_like(values)
    only[:, frames] = values[:, frames]
    return np.asarray(patterns.adjoint(only))


def _without(
    whole: NDArray[np.float32],
    own: NDArray[np.float32],
    level: NDArray[np.float32],
    total: NDArray[np.float32],
) -> Iterator[NDArray[np.float32]]:
    """Row by row, the correlations (N,) less those of one part, about the mean of the others."""
    for all_parts, one, mean in zip(whole, own, level, strict=True):
        yield all_parts - one - mean * total


def _best(scores: NDArray[np.float32], shape: tuple[int, int], around: int) -> NDArray[np.int64]:
    """Where the largest of (N,) scores are, no two of one group, and around the very largest."""
    wanted = min(_LISTED, len(scores))
    groups = min(_GROUPS, len(scores))
    deep = -(-len(scores) // groups)
    padded = np.full(deep * groups, -np.inf, np.float32)
    padded[: len(scores)] = scores
    # Neighbours are in different groups.
    by_group = padded.reshape(deep, groups)
    best = np.argpartition(by_group.max(axis=0), groups - wanted)[groups - wanted :]
    found = by_group[:, best].argmax(axis=0) * groups + best
    row, col = np.unravel_index(found[scores[found].argmax()], shape)
    near = np.arange(-around, around + 1)
    rows, cols = np.clip(row + near, 0, shape[0] - 1), np.clip(col + near, 0, shape[1] - 1)
    neighbours = np.ravel_multi_index(np.ix_(rows, cols), shape).ravel()
    return np.concatenate([found, neighbours]).astype(np.int64)


def _chooser(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    listed: NDArray[np.int64],
    train: NDArray[np.int64],
) -> Callable[[NDArray[np.float32]], NDArray[np.int64]]:
    """What chooses the next pixel of each row from the shortlist of its group, (groups, listed)."""
    columns = patterns.columns(listed.ravel()).reshape(patterns.count, *listed.shape)
    shown = np.ascontiguousarray(np.moveaxis(columns[train], 0, 1))

    def best_pixels(residual: NDArray[np.float32]) -> NDArray[np.int64]:
        grouped = residual.reshape(len(listed), -1, residual.shape[1])
        scores = grouped @ shown * scale[listed][:, None]
        return np.take_along_axis(listed, scores.argmax(axis=2), axis=1).ravel()

    return best_pixels
