"""Hypotheses of which pattern each frame shows: the likeliest one, and what it leaves unexplained.

Where exposures differ, a displaced frame may have been taken with the exposure of its place, as
when the projector was late, or with that of the frame it really is, as when a file is missing. So
a sample can be read at either exposure. All are cut off at the lowest clip level, that of the
longest exposure: up to there, every frame measures the light.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.pursuit import fold_count, predict_by_pursuit
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import work_ahead

# The scan looks at 24 to 96 rows, as many as 2.5e9 multiplications allow (about a second). A
# displacement may begin or end at 16 places; the runs of `frame_order.py` find the exact frame.
# Both were chosen by hand.
_FEWEST_ROWS, _MOST_ROWS, _SCAN_WORK = 24, 96, 2.5e9
_PLACES = 16
# Projector pixels at a time, so that sums stay in the processor's cache. Chosen by hand.
_PIXELS_AT_ONCE = 1 << 10


@dataclass(frozen=True, eq=False)
class RawRows:
    """Samples of some camera pixels, readable at another exposure.

    `shares` (m, K) are samples as shares of the `levels` (m, K) at which they clip.
    """

    shares: NDArray[np.float32]
    levels: NDArray[np.float32]

    @property
    def lowest(self) -> NDArray[np.float32]:
        """The level (m, 1) up to which all frames measure the light."""
        return np.asarray(self.levels.min(axis=1, keepdims=True))

    def light(self, exposed_as: NDArray[np.integer]) -> NDArray[np.float32]:
        """Samples (m, K), frame k read as exposed like frame exposed_as[k]; cut off at `lowest`."""
        return np.asarray(np.minimum(self.shares * self.levels[:, exposed_as], self.lowest))

    def exposure_groups(self) -> list[NDArray[np.int64]]:
        """Frames of the same clip level, group by group."""
        typical = np.median(self.levels, axis=0)
        _, kind = np.unique(np.round(np.log(typical), 2), return_inverse=True)
        return [np.flatnonzero(kind == each) for each in range(kind.max() + 1)]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The pattern that each frame shows (-1: unknown) and the frame whose exposure it has, (K,)."""

    order: NDArray[np.int64]
    exposed_as: NDArray[np.int64]

    @classmethod
    def in_order(cls, count: int) -> Hypothesis:
        """Each of K frames shows its own pattern."""
        return cls(np.arange(count), np.arange(count))

    @property
    def reversed(self) -> bool:
        """Whether the frames are backwards."""
        return bool((self.order == np.arange(len(self.order))[::-1]).all())


@dataclass(frozen=True, eq=False)
class Misses:
    """How far each of K frames is from what the rows should show under each pattern."""

    # Logarithm of the mean square difference of frame (row) and prediction (column), (K, K),
    # relative to the frame's own mean square. The prediction of a pattern never used the frames
    # that show it by the hypothesis.
    logarithms: NDArray[np.float64]
    # Whether the frame fits better as taken with the other frame's exposure, (K, K).
    elsewhere: NDArray[np.bool_]
    # Whether its own pattern differs between pixels, (K,); white and very fine stripes do not.
    informative: NDArray[np.bool_]

    @property
    def own(self) -> NDArray[np.float64]:
        """How far each frame is from its own pattern, (K,)."""
        return np.diag(self.logarithms)


def find_misses(
    patterns: PatternSet, rows: RawRows, hypothesis: Hypothesis, scale: NDArray[np.float32]
) -> Misses:
    """Compare each frame with what is predicted for each pattern; `column_scale` gives `scale`."""
    count = patterns.count
    light = rows.light(hypothesis.exposed_as)
    # What all rows do together is the brightness of the frame (flicker, the mean of the pattern):
    # no evidence of which pixels were lit, and a prediction of it would err in all rows alike.
    common = light.mean(axis=0)
    known = np.flatnonzero(hypothesis.order >= 0)
    shown = hypothesis.order[known]
    values = np.full(light.shape, np.nan, np.float32)
    values[:, shown] = (light - common)[:, known]
    fold = np.random.default_rng(0).permutation(count) % fold_count(count)
    # For some tens of rows a search of all pixels is quicker than making shortlists.
    predicted = predict_by_pursuit(patterns, scale, values, fold, shortlist=False)
    brightness = np.full(count, common.mean(), np.float32)
    brightness[shown] = common[known]
    predicted = np.minimum(predicted + brightness, rows.lowest)
    mean = light.mean(axis=1, keepdims=True)
    spread = np.maximum(light.std(axis=1, keepdims=True), 1e-12)

    def variation(samples: NDArray[np.float32]) -> NDArray[np.float64]:
        relative = ((samples - mean) / spread).astype(np.float64)
        return np.asarray(relative - relative.mean(axis=0))

    # `here` reads each frame at its own exposure, `there` at that of the frame whose pattern it may
    # show.
    observed, expected = variation(rows.light(np.arange(count))), variation(predicted)
    here = _log_misses(observed, expected)
    there = here.copy()
    for columns in rows.exposure_groups():
        if len(columns) < count:
            moved = variation(rows.light(np.full(count, columns[0])))
            there[:, columns] = _log_misses(moved, expected[:, columns])
    np.fill_diagonal(there, np.diag(here))
    # The prediction decides, since a frame read at the wrong exposure may seem uniform.
    power = (expected**2).mean(axis=0)
    return Misses(np.minimum(here, there), there < here, power > 0.25 * np.median(power))


def _log_misses(
    observed: NDArray[np.float64], expected: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Log of the square difference of each observed and expected column, relative, (K, k)."""
    power = (observed**2).sum(axis=0)[:, None]
    squares = power + (expected**2).sum(axis=0)[None, :]
    miss = squares - 2 * observed.T @ expected
    return np.asarray(np.log(np.maximum(miss, 1e-9) / np.maximum(power, 1e-9)))


def likeliest_hypothesis(patterns: PatternSet, rows: RawRows) -> Hypothesis | None:
    """The hypothesis under which single projector pixels follow the samples best; None: in order.

    It tries frames in order, in reverse, and displaced by one up to or from some place on. All
    frames count for all hypotheses, so chance raises the correlation of the best pixel alike in
    all, and nothing needs to be predicted.
    """
    count = patterns.count
    frames = np.arange(count)
    scanned = int(np.clip(_SCAN_WORK / (count * patterns.pixels), _FEWEST_ROWS, _MOST_ROWS))
    rows = RawRows(rows.shares[:scanned], rows.levels[:scanned])
    cuts = np.unique(np.linspace(0, count, _PLACES + 1).astype(int))
    hypotheses = _hypotheses(count, len(rows.exposure_groups()) > 1)
    centre = rows.light(frames).mean(axis=1, keepdims=True)
    values = []
    for each in hypotheses:
        light = rows.light(each.exposed_as) - centre
        values.append(np.where(each.order >= 0, light - light.mean(axis=0), 0))
    scores = _scan(patterns, hypotheses, values, list(itertools.pairwise(cuts)))
    winner = int(np.argmax([score.max() for score in scores]))
    place = int(scores[winner].argmax())
    if winner == 0 or scores[winner][place] <= scores[0][0]:
        return None
    changed = np.ones(count, bool)
    if place:
        # Places are numbered as `_mixtures` yields them.
        part, until = divmod(place + 1, 2)
        changed[slice(cuts[part], None) if until else slice(cuts[part])] = False
    if not changed.any():
        return None
    best = hypotheses[winner]
    return Hypothesis(
        np.where(changed, best.order, frames), np.where(changed, best.exposed_as, frames)
    )


def _hypotheses(count: int, several_exposures: bool) -> list[Hypothesis]:
    frames = np.arange(count)
    hypotheses = [Hypothesis.in_order(count)]
    for order in (np.append(frames[1:], -1), np.append(-1, frames[:-1]), frames[::-1].copy()):
        hypotheses.append(Hypothesis(order, frames))
        if several_exposures:
            hypotheses.append(Hypothesis(order, np.where(order >= 0, order, frames)))
    return hypotheses


def _scan(
    patterns: PatternSet,
    hypotheses: list[Hypothesis],
    values: list[NDArray[np.float32]],
    parts: list[tuple[int, int]],
) -> list[NDArray[np.float64]]:
    """How well single pixels follow the rows, by hypothesis and place; see `_mixtures`.

    Frames in order, as the first hypothesis has them, and frames backwards are so as a whole.
    """
    plain = values[0]
    count = patterns.count
    weights = [
        _by_pattern(light, each.order, count)
        for light, each in zip(values, hypotheses, strict=True)
    ]
    changes: list[list[tuple[slice, NDArray[np.float32]]]] = [[] for _ in hypotheses]
    for each, light, of_parts in zip(hypotheses[1:], values[1:], changes[1:], strict=True):
        for a, b in [] if each.reversed else parts:
            change = -_by_pattern(light[:, a:b], each.order[a:b], count)
            change[:, a:b] += plain[:, a:b]
            # Frames are displaced by one.
            near = slice(max(a - 1, 0), b + 1)
            of_parts.append((near, change[:, near]))

    def followed(start: int) -> list[NDArray[np.float32]]:
        """The largest sums over some pixels, by hypothesis: (places, m) each."""
        lit = normalized_columns(patterns, start, min(start + _PIXELS_AT_ONCE, patterns.pixels))
        in_order, largest = plain @ lit, []
        for weight, of_parts in zip(weights, changes, strict=True):
            products = (change @ lit[near] for near, change in of_parts)
            mixed = _mixtures(in_order, weight @ lit, products)
            largest.append(np.stack([sums.max(axis=1) for sums in mixed]))
        return largest

    best = [np.zeros((2 * len(of_parts) + 1, len(plain)), np.float32) for of_parts in changes]
    for largest in work_ahead(followed, range(0, patterns.pixels, _PIXELS_AT_ONCE)):
        for highest, of_some in zip(best, largest, strict=True):
            np.maximum(highest, of_some, out=highest)
    scores = []
    squares = [light**2 for light in values]
    for square, of_parts, highest in zip(squares, changes, best, strict=True):
        more = [(squares[0] - square)[:, a:b].sum(axis=1) for a, b in parts if of_parts]
        mixed = _mixtures(squares[0].sum(axis=1), square.sum(axis=1), more)
        power = np.stack([total.copy() for total in mixed])
        scores.append(explained(highest**2 / np.maximum(power, 1e-12)))
    return scores


def _by_pattern(
    light: NDArray[np.float32], order: NDArray[np.int64], count: int
) -> NDArray[np.float32]:
    """Samples of frames (m, k) at the patterns that these show, (m, count), 0 elsewhere."""
    found = np.zeros((len(light), count), np.float32)
    found[:, order[order >= 0]] = light[:, order >= 0]
    return found


def normalized_columns(patterns: PatternSet, start: int, stop: int) -> NDArray[np.float32]:
    """Projector pixels start..stop, mean 0 and norm 1 over the patterns, (K, n); 0 if constant."""
    columns = patterns.span(start, stop)
    columns = columns - columns.mean(axis=0)
    norm = np.sqrt((columns**2).sum(axis=0))
    return columns / np.where(norm < 1e-3 * np.sqrt(patterns.count), np.inf, norm)


def explained(share: NDArray[np.floating]) -> NDArray[np.float64]:
    """How well rows are explained, by the share of their variance: its mean -log(1 - share)."""
    return np.asarray(-np.log1p(-np.minimum(share, 0.999)).mean(axis=-1))


def _mixtures(
    plain: NDArray[np.float32],
    displaced: NDArray[np.float32],
    changes: Iterable[NDArray[np.float32]],
) -> Iterator[NDArray[np.float32]]:
    """Sums over parts: displaced as a whole; then from each part's end on, and up to there.

    `plain` and `displaced` are sums over all parts, `changes` by how much more each is plain.
    """
    yield displaced
    # The two sums that a place divides add up to this.
    both = plain + displaced
    total = displaced.copy()
    for change in changes:
        total += change
        yield total
        yield both - total
