"""Whether each frame shows its own pattern, and which photograph is missing, by the samples alone.

What some bright pixels should show under each pattern is predicted from the other frames
(`pursuit.py`). A frame is out of place if it misses the prediction for its own pattern and meets
that for another.

A lost frame displaces all later ones, which leaves few frames to predict from. So the likeliest
hypothesis about the order, all frames late or early by one up to or from some place on, is looked
for first: single projector pixels follow the samples best if it is right. Predictions are then made
as if it held. Where there is one photograph fewer than patterns, the same search finds its place.

Where exposures differ, a displaced frame may have been taken with the exposure of its place, as
when the projector was late, or with that of the frame it really is, as when a file is missing. So
a sample can be read at either exposure. All are cut off at the lowest clip level, that of the
longest exposure: up to there, every frame measures the light.

Diffuse scenes and very few patterns predict no frame; then nothing is claimed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.code_order import CodeLattice, missing_of_code
from lightmatrix.check.finding import WRONG_ORDER, Finding, order_findings
from lightmatrix.check.prediction import predict
from lightmatrix.check.pursuit import (
    PROJECTOR_PIXELS,
    best_pixels,
    column_scale,
    fold_count,
    predict_by_pursuit,
)
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import work_ahead

Floats = NDArray[np.float32]
Order = NDArray[np.int64]
Name = Callable[[int], str]


@dataclass(frozen=True)
class _Limits:
    """When a frame is out of place, and how much work may be spent on it.

    Chosen on simulated captures: `python -m benchmarks.frame_checks`.
    """

    # No order is inferred from fewer frames.
    frames: int = 12
    # A single frame is out of place if another prediction misses it by less than `decisive` of what
    # its own prediction does, and by less than `informative` of what the mean of each row does.
    # Two frames that meet each other's predictions need the latter pair.
    decisive: float = 0.45
    informative: float = 0.6
    decisive_of_two: float = 0.6
    informative_of_two: float = 0.7
    # Frames are suspected from this gain on, in the logarithm of the miss, but at most one in 6:
    # the others must predict them.
    suspicious: float = 0.2
    # Patterns are alike where the camera looks if the cosine between them, over the pixels that
    # rows follow, exceeds this. Chosen on crops of 45 captures under (micro) phase shifts.
    like: float = 0.7
    # Frames displaced alike support each other. A run of them has at least 3 frames, whose gain
    # exceeds `run_mean` in the mean and `run_sum` in sum. No frame counts for more than
    # `most_gain`, and each must gain more than `least_gain` to make a run richer.
    run_mean: float = 0.25
    run_sum: float = 2.5
    most_gain: float = 1.5
    least_gain: float = 0.1
    # Predictions that miss the median frame by more than this share of its variance accuse none.
    predictive: float = 0.8
    # Multiplications of a set of predictions from 24 to 200 rows, and of the search for the
    # likeliest hypothesis in 24 to 96 rows, each about a second.
    work: float = 2e10
    scan_work: float = 2.5e9
    # The best of the places at which a photograph may be missing is named if predictions miss less
    # than this share of the median row's variance.
    missed: float = 0.37


_LIMITS = _Limits()


def check_order(survey: Survey, name: Name) -> list[Finding]:
    """Frames that are swapped or displaced."""
    patterns = survey.patterns
    if patterns.count < _LIMITS.frames:
        return []
    cost = patterns.count * patterns.pixels * fold_count(patterns.count) * PROJECTOR_PIXELS
    wanted = int(np.clip(_LIMITS.work / cost, 24, 200))
    spread = np.zeros(len(survey.raw))
    for part, tile in survey.chunks():
        lowest = np.broadcast_to(tile.clip_level, tile.values.shape).min(axis=1, keepdims=True)
        spread[part] = np.minimum(tile.values, lowest).std(axis=1) * survey.valid[part]
    # A random choice among the better third: the very best are often all in one place.
    better = np.argsort(-spread)[: max(wanted, len(spread) // 3)]
    rows = np.random.default_rng(0).permutation(better[spread[better] > 0])[:wanted]
    samples = survey.samples(rows)
    levels = np.broadcast_to(samples.clip_level, samples.values.shape)
    light = RawRows(samples.values / levels, levels)
    return _Judge(patterns, light).findings(name)


@dataclass(frozen=True, eq=False)
class RawRows:
    """Samples of some camera pixels, readable at another exposure.

    `shares` (m, K) are samples as shares of the `levels` (m, K) at which they clip.
    """

    shares: Floats
    levels: Floats

    @property
    def lowest(self) -> Floats:
        """The level (m, 1) up to which all frames measure the light."""
        return np.asarray(self.levels.min(axis=1, keepdims=True))

    def light(self, exposed_as: NDArray[np.integer]) -> Floats:
        """Samples (m, K), frame k read as exposed like frame exposed_as[k]; cut off at `lowest`."""
        return np.asarray(np.minimum(self.shares * self.levels[:, exposed_as], self.lowest))

    def exposure_groups(self) -> list[Order]:
        """Frames of the same clip level, group by group."""
        typical = np.median(self.levels, axis=0)
        _, kind = np.unique(np.round(np.log(typical), 2), return_inverse=True)
        return [np.flatnonzero(kind == each) for each in range(kind.max() + 1)]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The pattern that each frame shows (-1: unknown) and the frame whose exposure it has, (K,)."""

    order: Order
    exposed_as: Order


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

    def predictive(self, order: Order) -> bool:
        """Whether most frames meet the predictions for the patterns that they should show."""
        met = self.logarithms[np.arange(len(order)), order]
        usual = np.median(met[(order >= 0) & self.informative])
        return bool(usual < np.log(_LIMITS.predictive))


class _Judge:
    """Which frames of a capture are out of place, by hypotheses about their order."""

    def __init__(self, patterns: PatternSet, rows: RawRows) -> None:
        self.patterns, self.rows = patterns, rows
        self.scale = column_scale(patterns)
        self.frames = np.arange(patterns.count)
        self.alike = _alike(patterns, rows, self.scale)
        in_order = self.misses(Hypothesis(self.frames, self.frames))
        # A pattern that is one grey says nothing of which pixels were lit, while its photograph may
        # well vary: with stripes finer than a bin, or where white clips.
        spread = np.concatenate([np.ptp(block, axis=1) for _, block in patterns.chunks()])
        self.in_order = replace(in_order, informative=in_order.informative & (spread > 1e-3))

    def findings(self, name: Name) -> list[Finding]:
        """A run of displaced frames, or single ones."""
        for first in (self.likeliest(), Hypothesis(self.frames, self.frames)):
            run = first and self.displaced_run(first)
            if not run:
                continue
            start, stop, step = run
            which = f"each image shows the pattern {'after' if step > 0 else 'before'} its own"
            message = (
                f"from {name(start)} to {name(stop)}, {which}: is one "
                f"{'missing' if step > 0 else 'extra'}?"
            )
            # The frame without a neighbour on that side cannot be displaced with the others.
            if start <= (step < 0) and stop >= len(self.frames) - 1 - (step > 0):
                message = f"the images do not follow the patterns: {which}"
            return [Finding("order", tuple(range(start, stop + 1)), message, WRONG_ORDER)]
        return order_findings(self.displaced_singly(), name)

    def misses(self, hypothesis: Hypothesis) -> Misses:
        """Compare each frame with what is predicted for each pattern."""
        rows, count = self.rows, len(self.frames)
        light = rows.light(hypothesis.exposed_as)
        # What all rows do together is the brightness of the frame (flicker, the mean of the
        # pattern): no evidence of which pixels were lit, and a prediction of it would err in all
        # rows alike.
        common = light.mean(axis=0)
        known = np.flatnonzero(hypothesis.order >= 0)
        shown = hypothesis.order[known]
        values = np.full(light.shape, np.nan, np.float32)
        values[:, shown] = (light - common)[:, known]
        fold = np.random.default_rng(0).permutation(count) % fold_count(count)
        predicted = predict_by_pursuit(self.patterns, self.scale, values, fold)
        brightness = np.full(count, common.mean(), np.float32)
        brightness[shown] = common[known]
        predicted = np.minimum(predicted + brightness, rows.lowest)
        mean = light.mean(axis=1, keepdims=True)
        spread = np.maximum(light.std(axis=1, keepdims=True), 1e-12)

        def variation(samples: Floats) -> NDArray[np.float64]:
            relative = ((samples - mean) / spread).astype(np.float64)
            return np.asarray(relative - relative.mean(axis=0))

        def logarithms(
            observed: NDArray[np.float64], expected: NDArray[np.float64]
        ) -> NDArray[np.float64]:
            power = (observed**2).sum(axis=0)[:, None]
            squares = power + (expected**2).sum(axis=0)[None, :]
            miss = squares - 2 * observed.T @ expected
            return np.asarray(np.log(np.maximum(miss, 1e-9) / np.maximum(power, 1e-9)))

        # `here` reads each frame at its own exposure, `there` at that of the frame whose pattern it
        # may show.
        expected = variation(predicted)
        here = logarithms(variation(rows.light(self.frames)), expected)
        there = here.copy()
        for columns in rows.exposure_groups():
            if len(columns) < count:
                moved = variation(rows.light(np.full(count, columns[0])))
                there[:, columns] = logarithms(moved, expected[:, columns])
        np.fill_diagonal(there, np.diag(here))
        # The prediction decides, since a frame read at the wrong exposure may seem uniform.
        power = (expected**2).mean(axis=0)
        return Misses(np.minimum(here, there), there < here, power > 0.25 * np.median(power))

    def likeliest(self) -> Hypothesis | None:
        """The hypothesis that single projector pixels follow best; None: in order.

        It tries frames in order, and displaced by one up to or from one of 16 places on; the runs
        find the exact frame. All frames count for all hypotheses, so chance raises the correlation
        of the best pixel alike in all, and nothing needs to be predicted.
        """
        frames, scanned = self.frames, _scanned_rows(self.patterns)
        rows = RawRows(self.rows.shares[:scanned], self.rows.levels[:scanned])
        cuts = np.unique(np.linspace(0, len(frames), 17).astype(int)).tolist()
        centre = rows.light(frames).mean(axis=1, keepdims=True)

        def read(order: Order, exposed_as: Order) -> tuple[Floats, Order]:
            light = rows.light(exposed_as) - centre
            return np.where(order >= 0, light - light.mean(axis=0), 0), order

        best, likeliest = -np.inf, None
        for order in (np.append(frames[1:], -1), np.append(-1, frames[:-1])):
            exposures = [frames]
            if len(rows.exposure_groups()) > 1:
                exposures.append(np.where(order >= 0, order, frames))
            for exposed_as in exposures:
                displaced = read(order, exposed_as)
                scores = scores_by_place(self.patterns, read(frames, frames), displaced, cuts)
                # From the last place on, which is the end, no frame is displaced.
                least = scores[0, -1]
                until, place = np.unravel_index(scores.argmax(), scores.shape)
                if scores.max() > max(best, least):
                    best = scores.max()
                    changed = (frames < cuts[place]) == bool(until)
                    likeliest = Hypothesis(
                        np.where(changed, order, frames), np.where(changed, exposed_as, frames)
                    )
        return likeliest

    def gain(self, misses: Misses, shown: Order) -> NDArray[np.float64]:
        """How much better each frame meets the pattern `shown` than its own, (K,)."""
        gain = np.minimum(self.in_order.own, misses.own) - misses.logarithms[self.frames, shown]
        gain[self.alike[self.frames, shown] | ~self.in_order.informative] = 0
        gain[shown == self.frames] = 0
        return np.asarray(np.clip(gain, -_LIMITS.most_gain, _LIMITS.most_gain))

    def displaced_run(self, hypothesis: Hypothesis) -> tuple[int, int, int] | None:
        """First, last frame and step of the frames that show the pattern `step` after their own."""
        misses = self.in_order
        for confirm in (False, True):
            if not (hypothesis.order == self.frames).all():
                misses = self.misses(hypothesis)
            predictive = misses.predictive(hypothesis.order)
            best: tuple[float, int, int, int] = (0.0, 0, 0, 0)
            for step in (1, -1):
                shown = np.clip(self.frames + step, 0, self.patterns.count - 1)
                gain = self.gain(misses, shown)
                # The run of the largest sum.
                total = np.append(0, np.cumsum(gain - _LIMITS.least_gain))
                stop = int((total - np.minimum.accumulate(total)).argmax())
                start = int(total[: stop + 1].argmin())
                run = gain[start:stop]
                supported = run.sum() > max(_LIMITS.run_sum, _LIMITS.run_mean * len(run))
                if not confirm or (predictive and supported):
                    best = max(best, (float(run.sum()), start, stop, step))
            _, start, stop, step = best
            if stop - start < 3:
                return None
            # Once more, from frames as they now seem to be.
            moved = self.frames[start:stop]
            order, exposed_as = self.frames.copy(), self.frames.copy()
            order[moved] += step
            if misses.elsewhere[moved, moved + step].mean() > 0.5:
                exposed_as[moved] += step
            hypothesis = Hypothesis(order, exposed_as)
        return start, stop - 1, step

    def displaced_singly(self) -> dict[int, int]:
        """Which frame shows the pattern of which other frame."""
        suspicion = self.in_order.own - self.others(self.in_order).min(axis=1)
        suspects = np.argsort(-suspicion)[: self.patterns.count // 6]
        suspects = suspects[
            (suspicion[suspects] > _LIMITS.suspicious) & self.in_order.informative[suspects]
        ]
        if not len(suspects):
            return {}
        # Judged by the frames that are not suspected.
        order = self.frames.copy()
        order[suspects] = -1
        misses = self.misses(Hypothesis(order, self.frames))
        if not misses.predictive(order):
            return {}
        others = self.others(misses)
        own = np.minimum(self.in_order.own, misses.own)
        shown: dict[int, int] = {}
        for k in map(int, np.sort(suspects)):
            s = int(others[k].argmin())
            gain, miss = own[k] - others[k, s], others[k, s]
            back, miss_back = own[s] - others[s, k], others[s, k]
            clear = gain > -np.log(_LIMITS.decisive) and miss < np.log(_LIMITS.informative)
            swapped = gain + back > -2 * np.log(_LIMITS.decisive_of_two)
            swapped &= max(miss, miss_back) < np.log(_LIMITS.informative_of_two)
            if swapped and (clear or min(gain, back) > _LIMITS.suspicious):
                shown |= {k: s, s: k}
            elif clear and k not in shown:
                shown[k] = s
        return shown

    def others(self, misses: Misses) -> NDArray[np.float64]:
        """Misses from the patterns of other frames that are not alike, (K, K)."""
        own = np.eye(len(self.frames), dtype=bool)
        return np.where(self.alike | own, np.inf, misses.logarithms)


def _alike(patterns: PatternSet, rows: RawRows, scale: Floats) -> NDArray[np.bool_]:
    """Which pairs of different frames show (nearly) the same pattern and may change places, (K, K).

    Either they differ by less than 2 % of the usual variance of a pixel, over 4096 pixels at
    random. Or they are grey patterns that are alike at the projector pixels that rows follow, as
    fine stripes of nearly the same period are in a part of the projector. Bits are never said to
    be: from swapped frames, rows choose pixels at which these bits agree.
    """
    sample = np.random.default_rng(0).permutation(patterns.pixels)[:4096]
    shown = patterns.columns(sample).astype(np.float64)
    power = (shown**2).sum(axis=1)
    distance = power[:, None] + power[None, :] - 2 * shown @ shown.T
    alike = distance < 0.02 * len(sample) * shown.var(axis=0).mean()
    if patterns.as_bits() is None:
        light = rows.light(np.arange(patterns.count))
        places = best_pixels(patterns, scale, light - light.mean(axis=1, keepdims=True))
        seen = patterns.columns(places).astype(np.float64)
        seen -= seen.mean(axis=1, keepdims=True)
        length = np.maximum(np.sqrt((seen**2).sum(axis=1)), 1e-9)
        alike |= seen @ seen.T > _LIMITS.like * np.outer(length, length)
    return np.asarray(alike & ~np.eye(len(alike), dtype=bool))


def _scanned_rows(patterns: PatternSet) -> int:
    return int(np.clip(_LIMITS.scan_work / (patterns.count * patterns.pixels), 24, 96))


def scores_by_place(
    patterns: PatternSet,
    plain: tuple[Floats, Order],
    displaced: tuple[Floats, Order],
    cuts: Sequence[int],
) -> NDArray[np.float64]:
    """How well single pixels follow frames that are displaced from each place on, or up to it.

    `plain` and `displaced` are two readings of frames: samples less their mean (m, K), and the
    pattern that each frame shows (K,). The places `cuts` rise from 0. The scores, (2, places), are
    the mean over the rows of -log(1 - the share of the variance that the best pixel explains).
    """
    (light, order), (moved, shown) = plain, displaced
    steps = list(itertools.pairwise([0, *cuts]))

    def followed(start: int) -> Floats:
        """The largest sums over 1024 pixels, as many as caches hold, (places, 2, m)."""
        columns = patterns.span(start, min(start + 1024, patterns.pixels))
        columns = columns - columns.mean(axis=0)
        norm = np.sqrt((columns**2).sum(axis=0))
        # Pixels that are constant over the patterns count nothing.
        lit = columns / np.where(norm < 1e-3 * np.sqrt(patterns.count), np.inf, norm)
        total = moved @ lit[shown]
        both = light @ lit[order] + total
        largest = np.empty((len(cuts), 2, len(light)), np.float32)
        for place, (a, b) in enumerate(steps):
            total += light[:, a:b] @ lit[order[a:b]] - moved[:, a:b] @ lit[shown[a:b]]
            largest[place] = total.max(axis=1), (both - total).max(axis=1)
        return largest

    best = reduce(np.maximum, work_ahead(followed, range(0, patterns.pixels, 1024)))
    squares, of_moved = light**2, moved**2
    power = np.array(
        [
            [
                squares[:, :cut].sum(axis=1) + of_moved[:, cut:].sum(axis=1),
                squares[:, cut:].sum(axis=1) + of_moved[:, :cut].sum(axis=1),
            ]
            for cut in cuts
        ]
    )
    share = np.maximum(best, 0) ** 2 / np.maximum(power, 1e-12)
    return np.asarray(-np.log1p(-np.minimum(share, 0.999)).mean(axis=-1).T, np.float64)


def check_counts(survey: Survey | None, patterns: int, images: Sequence[Path]) -> Finding:
    """State that the numbers differ, and, with a survey of all, which photograph is missing."""
    count = len(images)
    message = f"{patterns} patterns, but {count} photographs"
    frames = missing_places(survey) if survey is not None and count == patterns - 1 else ()
    if frames:
        which = " or ".join(map(str, frames))
        message += f": that of pattern {which} (counted from 0) is missing"
        if len(frames) == 1 and frames[0] < count:
            message += f", before {images[frames[0]].name}"
    digits = ["".join(c for c in path.stem if c.isdecimal() and c.isascii()) for path in images]
    if digits and all(digits) and not frames:
        numbers = {int(each) for each in digits}
        absent = sorted(set(range(min(numbers), max(numbers) + 1)) - numbers)
        # Names count in steps, and have no gaps, if they leave out more than a quarter.
        if absent and 4 * len(absent) <= count:
            message += f"; their names leave out number {', '.join(map(str, absent[:5]))}"
    advice = (
        "take it again, or leave the pattern out too"
        if count < patterns
        else "remove what is no photograph of a pattern: a test shot, a frame taken twice, the "
        "black frame?"
    )
    return Finding("counts", frames, message, advice)


def missing_places(survey: Survey) -> tuple[int, ...]:
    """Which of K patterns may have no frame among K - 1 frames; empty if unknown."""
    patterns, count = survey.patterns, survey.count
    lattice = CodeLattice.of(survey)
    if lattice is not None:
        return missing_of_code(lattice)
    if count < _LIMITS.frames:
        return ()
    frames = np.arange(count)
    rows = high_variance_rows(replace(survey, patterns=patterns.subset(frames)))
    if len(rows) < 24:
        return ()
    rows = np.random.default_rng(0).permutation(rows)[:96]
    samples = survey.samples(rows[: _scanned_rows(patterns)])
    values = np.where(samples.clipped, np.nan, samples.values)
    light = np.nan_to_num(values - np.nanmean(values, axis=1, keepdims=True)).astype(np.float32)
    # The frames after the missing one show the pattern after that of their number.
    places = range(patterns.count)
    guess = int(scores_by_place(patterns, (light, frames), (light, frames + 1), places)[0].argmax())
    samples, misses = survey.samples(rows), {}
    for place in range(max(0, guess - 3), min(count, guess + 3) + 1):
        shown = patterns.subset(np.delete(np.arange(patterns.count), place))
        misses[place] = float(np.median(predict(shown, samples).miss))
    best = min(misses, key=misses.__getitem__)
    return (best,) if misses[best] < _LIMITS.missed else ()
