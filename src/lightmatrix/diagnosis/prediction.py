"""What camera pixels should show under each pattern, predicted from the other frames.

Where a camera pixel sees a few projector pixels, its samples follow those pixels of the patterns.
So it is explained, from part of the frames, by the few projector pixels that correlate best
(orthogonal matching pursuit, Pati et al. 1993), and what it should show under the other patterns is
predicted (cross-validation).

Where exposures differ, a displaced frame may have been taken with the exposure of its place, as
when the projector was late, or with that of the frame it really is, as when a file is missing. A
sample is then read at either exposure. All are cut off at the lowest clip level, that of the
longest exposure: up to there, all frames tell the light apart.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.pattern_set import PatternSet

PROJECTOR_PIXELS = 3
_CORRELATION_BYTES = 64 << 20
# The scan over assumptions: rows, places where a displacement may begin or end, and projector
# pixels at a time, so that sums stay in the cache.
_SCAN_ROWS = 96
_SCAN_PLACES = 16
_SCAN_PIXELS = 512
_SCAN_WORK = 2.5e9


def folds(count: int) -> int:
    """Parts of the patterns that are predicted from the rest; few frames can spare only few."""
    return 8 if count <= 64 else 4 if count < 128 else 2


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples of some camera pixels, readable at another exposure.

    Parameters
    ----------
    shares : (m, K) float32
        Samples as shares of the level at which they clip.
    levels : (m, K) float32
        That level, which falls as the exposure grows.
    """

    shares: NDArray[np.float32]
    levels: NDArray[np.float32]

    @property
    def lowest(self) -> NDArray[np.float32]:
        """Level (m, 1) up to which all frames tell the light apart."""
        return np.asarray(self.levels.min(axis=1, keepdims=True))

    def light(self, taken: NDArray[np.integer]) -> NDArray[np.float32]:
        """Samples (m, K), frame k read as taken like frame taken[k]; cut off at `lowest`."""
        return np.asarray(np.minimum(self.shares * self.levels[:, taken], self.lowest))


@dataclass(frozen=True, eq=False)
class Assumption:
    """What the frames are taken for.

    Parameters
    ----------
    order : (K,) int
        The pattern shown in each frame; -1 for none that is known.
    taken : (K,) int
        The frame whose exposure each frame was taken with.
    """

    order: NDArray[np.int64]
    taken: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Misses:
    """How far each observed frame is from what the pixels should show under each pattern.

    Parameters
    ----------
    logarithms : (K, K) float64
        Of the mean square difference of observed frame (row) and prediction (column), relative
        to the frame's own mean square. The prediction of a pattern never used the frames that
        were assumed to show it.
    elsewhere : (K, K) bool
        Whether the frame fits better as taken with the other frame's exposure.
    telling : (K,) bool
        Whether its own pattern differs between pixels; white and very fine stripes do not.
    """

    logarithms: NDArray[np.float64]
    elsewhere: NDArray[np.bool_]
    telling: NDArray[np.bool_]

    @property
    def own(self) -> NDArray[np.float64]:
        """Of each frame from its own pattern, (K,)."""
        return np.diag(self.logarithms)


def prediction_misses(
    patterns: PatternSet, rows: Rows, assumption: Assumption, scale: NDArray[np.float32]
) -> Misses:
    """Compare what is observed in each frame with what is predicted for each pattern.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    rows : Rows
        Observed samples.
    assumption : Assumption
        What the frames are taken for, where pixels are explained from them.
    scale : (N,) float32
        See `column_scale`.
    """
    count = patterns.count
    frames = np.arange(count)
    light = rows.light(assumption.taken)
    # What all rows do together is the brightness of the frame (flicker, the mean of the pattern):
    # no evidence of which pixels were lit, and a prediction of it would err in all rows alike.
    common = light.mean(axis=0, keepdims=True)
    order = assumption.order
    predicted = np.empty((len(light), count), np.float32)
    fold = np.random.default_rng(0).permutation(count) % folds(count)
    for part in range(folds(count)):
        train = np.flatnonzero((order >= 0) & (fold[order] != part))
        held = np.flatnonzero(fold == part)
        predicted[:, held] = predicted_samples(patterns, scale, light - common, order, train, held)
    brightness = np.full(count, common.mean(), np.float32)
    brightness[order[order >= 0]] = common[0, order >= 0]
    predicted = np.minimum(predicted + brightness, rows.lowest)
    mean = light.mean(axis=1, keepdims=True)
    spread = np.maximum(light.std(axis=1, keepdims=True), 1e-12)

    def variation(values: NDArray[np.float32]) -> NDArray[np.float64]:
        relative = ((values - mean) / spread).astype(np.float64)
        return np.asarray(relative - relative.mean(axis=0, keepdims=True))

    def compare(
        observed: NDArray[np.float64], expected: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        power = (observed**2).sum(axis=0)[:, None]
        squares = power + (expected**2).sum(axis=0)[None, :]
        miss = squares - 2 * observed.T @ expected
        return np.asarray(np.log(np.maximum(miss, 1e-9) / np.maximum(power, 1e-9)))

    observed, expected = variation(rows.light(frames)), variation(predicted)
    here = compare(observed, expected)
    there = here.copy()
    for columns in _taken_alike(rows):
        if len(columns) < count:
            moved = variation(rows.light(np.full(count, columns[0])))
            there[:, columns] = compare(moved, expected[:, columns])
    np.fill_diagonal(there, np.diag(here))
    # Of the prediction: a frame read at the wrong exposure may seem to be the same all over.
    power = (expected**2).mean(axis=0)
    return Misses(np.minimum(here, there), there < here, power > 0.25 * np.median(power))


def _taken_alike(rows: Rows) -> list[NDArray[np.int64]]:
    """Frames of the same clip level, group by group."""
    typical = np.median(rows.levels, axis=0)
    _, kind = np.unique(np.round(np.log(typical), 2), return_inverse=True)
    return [np.flatnonzero(kind == each) for each in range(kind.max() + 1)]


def likeliest_assumption(patterns: PatternSet, rows: Rows) -> Assumption | None:
    """The assumption under which single projector pixels follow the samples best.

    Tried are frames in order, in reverse, and displaced by one up to or from some place on, at
    `_SCAN_PLACES` places. All frames count for all assumptions, so that none of them needs to be
    predicted: the correlation of the best pixel is larger by chance alike.

    Returns
    -------
    Assumption, optional
        None for frames in order.
    """
    count = patterns.count
    frames = np.arange(count)
    some = int(np.clip(_SCAN_WORK / (count * patterns.pixels), 24, _SCAN_ROWS))
    rows = Rows(rows.shares[:some], rows.levels[:some])
    some = len(rows.shares)
    cuts = np.unique(np.linspace(0, count, _SCAN_PLACES + 1).astype(int))
    parts = list(itertools.pairwise(cuts))
    ways = [Assumption(frames, frames)]
    several = len(_taken_alike(rows)) > 1
    for order in (np.append(frames[1:], -1), np.append(-1, frames[:-1]), frames[::-1].copy()):
        ways.append(Assumption(order, frames))
        if several:
            ways.append(Assumption(order, np.where(order >= 0, order, frames)))
    centre = rows.light(frames).mean(axis=1, keepdims=True)
    values = []
    for way in ways:
        light = rows.light(way.taken) - centre
        values.append(np.where(way.order >= 0, light - light.mean(axis=0), 0))
    best = [np.zeros((2 * len(cuts) - 1, some), np.float32) for _ in ways]
    for start in range(0, patterns.pixels, _SCAN_PIXELS):
        stop = min(start + _SCAN_PIXELS, patterns.pixels)
        lit = patterns.columns(np.arange(start, stop))
        lit = lit - lit.mean(axis=0)
        spread = np.sqrt((lit**2).sum(axis=0))
        lit /= np.where(spread < 1e-3 * np.sqrt(count), np.inf, spread)
        products = [
            [light[:, a:b] @ shown[a:b] for a, b in parts]
            for light, shown in zip(values, (lit[way.order] for way in ways), strict=True)
        ]
        for product, found in zip(products, best, strict=True):
            for k, sums in enumerate(_mixtures(products[0], product)):
                np.maximum(found[k], sums.max(axis=1), out=found[k])
    scores = []
    squares = [[(light[:, a:b] ** 2).sum(axis=1) for a, b in parts] for light in values]
    for way, square, found in zip(ways, squares, best, strict=True):
        power = np.stack([total.copy() for total in _mixtures(squares[0], square)])
        explained = np.minimum(found**2 / np.maximum(power, 1e-12), 0.999)
        scores.append(-np.log1p(-explained).mean(axis=1))
        if (way.order == frames[::-1]).all():
            scores[-1][1:] = -np.inf
    winner = int(np.argmax([score.max() for score in scores]))
    place = int(scores[winner].argmax())
    if winner == 0 or scores[winner][place] <= scores[0][0]:
        return None
    changed = np.ones(count, bool)
    if 0 < place < len(cuts):
        changed[: cuts[place]] = False
    elif place >= len(cuts):
        changed[cuts[place - len(cuts) + 1] :] = False
    if not changed.any():
        return None
    way = ways[winner]
    return Assumption(np.where(changed, way.order, frames), np.where(changed, way.taken, frames))


def _mixtures(
    plain: list[NDArray[np.float32]], displaced: list[NDArray[np.float32]]
) -> Iterator[NDArray[np.float32]]:
    """Sums over parts: displaced from each part on, or none, then up to each part."""
    total = np.sum(displaced, axis=0)
    yield total
    changes = [own - other for own, other in zip(plain, displaced, strict=True)]
    for change in changes:
        total += change
        yield total
    for change in changes:
        total -= change
        yield total


def predicted_samples(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    values: NDArray[np.float32],
    order: NDArray[np.integer],
    train: NDArray[np.integer],
    held: NDArray[np.integer],
) -> NDArray[np.float32]:
    """What each row should show under the patterns `held`, from the frames `train`.

    All projector pixels are looked through.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    scale : (N,) float32
        See `column_scale`.
    values : (m, K) float32
        Samples, of each frame what all rows have in common taken off; only `train` is looked at.
    order : (K,) int
        The pattern shown in each frame.
    train, held : (k,) int
        Frames that rows are explained from; patterns to predict.

    Returns
    -------
    (m, len(held)) float32
    """
    shown = order[train]
    return pursued(
        patterns,
        values,
        order,
        train,
        held,
        lambda residual: _best_pixels(patterns, scale, residual, shown),
    )


def pursued(
    patterns: PatternSet,
    values: NDArray[np.float32],
    order: NDArray[np.integer],
    train: NDArray[np.integer],
    held: NDArray[np.integer],
    best_pixels: Callable[[NDArray[np.float32]], NDArray[np.int64]],
) -> NDArray[np.float32]:
    """As `predicted_samples`, with a choice of its own of the next pixel of each row.

    Parameters
    ----------
    patterns, values, order, train, held
        See `predicted_samples`.
    best_pixels : callable
        Given residuals (m, len(train)), the pixel (m,) that correlates best with each.
    """
    mean = values[:, train].mean(axis=1, keepdims=True)
    centred = values[:, train] - mean
    residual = centred
    chosen = np.empty((len(values), 0), np.int64)
    for _ in range(PROJECTOR_PIXELS):
        chosen = np.column_stack([chosen, best_pixels(residual)])
        columns = patterns.columns(chosen.ravel()).reshape(patterns.count, *chosen.shape)
        shown = columns[order[train]]
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


def _best_pixels(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    residual: NDArray[np.float32],
    shown: NDArray[np.integer],
) -> NDArray[np.int64]:
    """The projector pixel that correlates best with each row of residuals, (m,)."""
    spread = np.zeros((len(residual), patterns.count), np.float32)
    spread[:, shown] = residual
    group = max(1, _CORRELATION_BYTES // (4 * patterns.pixels))
    # Pixels that no frame tells apart are chosen between by lot, row by row: were it always the
    # first, all rows would agree on a prediction that nothing supports.
    lots = 1 + 1e-3 * np.random.default_rng(0).random(2 * patterns.pixels, np.float32)
    best = np.empty(len(spread), np.int64)
    for start in range(0, len(spread), group):
        for row, scores in enumerate(patterns.adjoint(spread[start : start + group]), start):
            first = row * 7919 % patterns.pixels
            best[row] = (scores * scale * lots[first : first + patterns.pixels]).argmax()
    return best


def column_scale(patterns: PatternSet) -> NDArray[np.float32]:
    """One over the standard deviation of each projector pixel over the patterns; 0 if constant."""
    total = np.zeros(patterns.pixels)
    squares = np.zeros(patterns.pixels)
    for _, block in patterns.chunks():
        total += block.sum(axis=0, dtype=np.float64)
        squares += np.einsum("kn,kn->n", block, block)
    variance = squares / patterns.count - (total / patterns.count) ** 2
    steady = variance < 1e-6
    return np.where(steady, 0, 1 / np.sqrt(np.where(steady, 1, variance))).astype(np.float32)
