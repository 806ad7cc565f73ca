"""Whether each frame shows its own pattern, by the samples alone.

What some bright pixels should show under each pattern is predicted from the other frames
(`pursuit.py`). A frame is out of place if it misses the prediction for its own pattern and meets
that for another.

A lost frame displaces all later ones, which leaves few frames to predict from. So the likeliest
hypothesis about the order, such as all frames late by one from some place on, is looked for first,
and predictions are made as if it held (`order_hypotheses.py`).

Diffuse scenes and very few patterns predict no frame; then nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.order_hypotheses import (
    Hypothesis,
    Misses,
    RawRows,
    find_misses,
    likeliest_hypothesis,
)
from lightmatrix.diagnosis.pursuit import PROJECTOR_PIXELS, best_pixels, column_scale, fold_count
from lightmatrix.patterns.pattern_set import PatternSet

# The thresholds below were chosen on simulated captures: `python -m benchmarks.frame_checks`.
#
# A single frame is out of place if another prediction misses it by less than 45 % of what its own
# prediction does, and by less than 60 % of what the mean of each row does. Two frames that meet
# each other's predictions need 60 % and 70 % each. Frames are suspected from a gain of 0.2 on, in
# the logarithm of the miss, but at most one in 6: the others must predict them.
_DECISIVE, _INFORMATIVE = 0.45, 0.6
_DECISIVE_OF_TWO, _INFORMATIVE_OF_TWO = 0.6, 0.7
_SUSPICIOUS, _SUSPECTS = 0.2, 6
# Patterns are alike where the camera looks if the cosine between them, over the pixels that rows
# follow, exceeds 0.7. Chosen on crops of 45 captures under phase and micro phase shifts.
_LIKE = 0.7
# Frames displaced alike support each other. A run of them has at least 3 frames, whose gain is
# above 0.25 in the mean and 2.5 in sum. No frame counts for more than 1.5, and each must gain more
# than 0.1 to make a run richer.
_SHORTEST_RUN = 3
_RUN_MEAN, _RUN_SUM = 0.25, 2.5
_MOST_GAIN, _LEAST_GAIN = 1.5, 0.1
# Predictions that miss the median frame by more than 80 % of its variance accuse none.
_PREDICTIVE = 0.8
# Patterns that vary by less than 0.1 %, after binning or not, are one grey; two patterns are alike
# if they differ by less than 2 % of the usual variance of a pixel, over 4096 pixels drawn at
# random.
_ONE_GREY = 1e-3
_ALIKE, _ALIKE_PIXELS = 0.02, 4096
# The fewest frames and rows by which an order is judged, the fewest and most rows that are wanted,
# and the multiplications that one set of predictions may take (about a second).
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 16
_FEW_ROWS, _MANY_ROWS, _WORK = 24, 200, 2e10

_ADVICE = (
    "put the images in the order of the patterns, or take the capture again, waiting longer after "
    "each change of pattern"
)
Name = Callable[[int], str]


def find_disorder(
    patterns: PatternSet,
    tiles: Iterable[tuple[int, Samples]],
    rows: int,
    name: Name = "frame {}".format,
) -> list[Finding]:
    """Frames that are swapped, displaced or reversed; `tiles` hold all `rows` camera rows."""
    if patterns.count < _FEWEST_FRAMES:
        return []
    bright = _bright_rows(patterns, tiles, rows)
    return [] if bright is None else _Judge(patterns, bright).findings(name)


def order_findings(shown: Mapping[int, int], name: Name) -> list[Finding]:
    """State which single frames show the pattern of which other frame."""
    findings = []
    for frame, pattern in sorted(shown.items()):
        if shown.get(pattern) != frame:
            message = (
                f"{name(frame)} shows the pattern of {name(pattern)}: is it swapped, repeated or "
                "late?"
            )
            findings.append(Finding("order", (frame,), message, _ADVICE))
        elif frame < pattern:
            message = f"{name(frame)} and {name(pattern)} look swapped"
            findings.append(Finding("order", (frame, pattern), message, _ADVICE))
    return findings


class _Judge:
    """Which frames of a capture are out of place, by hypotheses about their order."""

    def __init__(self, patterns: PatternSet, rows: RawRows) -> None:
        self.patterns, self.rows = patterns, rows
        self.scale = column_scale(patterns)
        self.frames = np.arange(patterns.count)
        self.alike = _alike(patterns) | _alike_where_seen(patterns, rows, self.scale)
        in_order = self.misses(Hypothesis.in_order(patterns.count))
        # A pattern that is one grey says nothing of which pixels were lit, while its photograph may
        # well vary: with stripes finer than a bin, or where white clips.
        self.in_order = replace(in_order, informative=in_order.informative & _varied(patterns))

    def misses(self, hypothesis: Hypothesis) -> Misses:
        return find_misses(self.patterns, self.rows, hypothesis, self.scale)

    def findings(self, name: Name) -> list[Finding]:
        """Frames backwards, or a run of displaced ones, or single ones."""
        likeliest = likeliest_hypothesis(self.patterns, self.rows)
        if likeliest is not None and likeliest.reversed and self.backwards(likeliest):
            message = "the images follow the patterns backwards"
            return [Finding("order", tuple(range(self.patterns.count)), message, _ADVICE)]
        for first in (likeliest, Hypothesis.in_order(self.patterns.count)):
            run = first and self.displaced_run(first)
            if run:
                start, stop, _ = run
                message = _describe_run(*run, self.patterns.count, name)
                return [Finding("order", tuple(range(start, stop + 1)), message, _ADVICE)]
        return order_findings(self.displaced_singly(), name)

    def backwards(self, hypothesis: Hypothesis) -> bool:
        """Whether frames meet the predictions of the reversed order."""
        misses = self.misses(hypothesis)
        gain = self.gain(misses, hypothesis.order)
        return _predictive(misses, hypothesis.order) and _supported(gain, 0, len(gain))

    def gain(self, misses: Misses, shown: NDArray[np.int64]) -> NDArray[np.float64]:
        """How much better each frame meets the pattern `shown` than its own, (K,)."""
        gain = np.minimum(self.in_order.own, misses.own) - misses.logarithms[self.frames, shown]
        gain[self.alike[self.frames, shown] | ~self.in_order.informative] = 0
        return gain

    def displaced_run(self, hypothesis: Hypothesis) -> tuple[int, int, int] | None:
        """First, last frame and step of the frames that show the pattern `step` after their own."""
        misses = self.in_order
        for confirm in (False, True):
            if not (hypothesis.order == self.frames).all():
                misses = self.misses(hypothesis)
            predictive = _predictive(misses, hypothesis.order)
            best: tuple[float, int, int, int] = (0.0, 0, 0, 0)
            for step in (1, -1):
                shown = np.clip(self.frames + step, 0, self.patterns.count - 1)
                gain = self.gain(misses, shown)
                gain[shown == self.frames] = 0
                start, stop = _richest_run(np.clip(gain, -_MOST_GAIN, _MOST_GAIN) - _LEAST_GAIN)
                if not confirm or (predictive and _supported(gain, start, stop)):
                    best = max(best, (float(gain[start:stop].sum()), start, stop, step))
            _, start, stop, step = best
            if stop - start < _SHORTEST_RUN:
                return None
            # Once more, from frames as they now seem to be.
            run = self.frames[start:stop]
            order, exposed_as = self.frames.copy(), self.frames.copy()
            order[run] = run + step
            if misses.elsewhere[run, run + step].mean() > 0.5:
                exposed_as[run] = run + step
            hypothesis = Hypothesis(order, exposed_as)
        return start, stop - 1, step

    def displaced_singly(self) -> dict[int, int]:
        """Which frame shows the pattern of which other frame."""
        suspicion = self.in_order.own - self.others(self.in_order).min(axis=1)
        suspects = np.argsort(-suspicion)[: self.patterns.count // _SUSPECTS]
        suspects = suspects[
            (suspicion[suspects] > _SUSPICIOUS) & self.in_order.informative[suspects]
        ]
        if not len(suspects):
            return {}
        # Judged by the frames that are not suspected.
        order = self.frames.copy()
        order[suspects] = -1
        misses = self.misses(Hypothesis(order, self.frames))
        if not _predictive(misses, order):
            return {}
        others = self.others(misses)
        own = np.minimum(self.in_order.own, misses.own)
        shown: dict[int, int] = {}
        for k in map(int, np.sort(suspects)):
            s = int(others[k].argmin())
            gain, miss = own[k] - others[k, s], others[k, s]
            back, miss_back = own[s] - others[s, k], others[s, k]
            clear = gain > -np.log(_DECISIVE) and miss < np.log(_INFORMATIVE)
            swapped = gain + back > -2 * np.log(_DECISIVE_OF_TWO)
            swapped &= max(miss, miss_back) < np.log(_INFORMATIVE_OF_TWO)
            if swapped and (clear or min(gain, back) > _SUSPICIOUS):
                shown |= {k: s, s: k}
            elif clear and k not in shown:
                shown[k] = s
        return shown

    def others(self, misses: Misses) -> NDArray[np.float64]:
        """Misses from the patterns of other frames that are not alike, (K, K)."""
        own = np.eye(len(self.frames), dtype=bool)
        return np.where(self.alike | own, np.inf, misses.logarithms)


def _richest_run(gain: NDArray[np.float64]) -> tuple[int, int]:
    """The frames start..stop of the largest sum."""
    total = np.append(0, np.cumsum(gain))
    lowest = np.minimum.accumulate(total)
    stop = int((total - lowest).argmax())
    return int(total[: stop + 1].argmin()), stop


def _supported(gain: NDArray[np.float64], start: int, stop: int) -> bool:
    run = np.clip(gain[start:stop], -_MOST_GAIN, _MOST_GAIN)
    return len(run) >= _SHORTEST_RUN and run.mean() > _RUN_MEAN and run.sum() > _RUN_SUM


def _predictive(misses: Misses, order: NDArray[np.int64]) -> bool:
    """Whether most frames meet the predictions for the patterns that they should show."""
    met = misses.logarithms[np.arange(len(order)), order]
    return bool(np.median(met[(order >= 0) & misses.informative]) < np.log(_PREDICTIVE))


def _bright_rows(
    patterns: PatternSet, tiles: Iterable[tuple[int, Samples]], rows: int
) -> RawRows | None:
    """Some of the rows that vary most, in random order; None if hardly any varies."""
    cost = patterns.count * patterns.pixels * fold_count(patterns.count) * PROJECTOR_PIXELS
    wanted = int(np.clip(_WORK / cost, _FEW_ROWS, _MANY_ROWS))
    generator = np.random.default_rng(0)
    shares, levels = [], []
    for _, tile in tiles:
        level = np.broadcast_to(tile.clip_level, tile.values.shape)
        values = np.minimum(tile.values, level.min(axis=1, keepdims=True))
        spread = values.std(axis=1)
        share = -(-wanted * len(values) // rows)
        # A random choice among the better third: the very best are often all in one place.
        better = np.argsort(-spread)[: max(share, len(values) // 3)]
        pick = generator.permutation(better)[:share]
        pick = pick[spread[pick] > 0]
        shares.append(tile.values[pick] / level[pick])
        levels.append(level[pick])
    bright = RawRows(np.concatenate(shares), np.concatenate(levels))
    mixed = generator.permutation(len(bright.shares))
    return (
        RawRows(bright.shares[mixed], bright.levels[mixed]) if len(mixed) >= _FEWEST_ROWS else None
    )


def _alike(patterns: PatternSet) -> NDArray[np.bool_]:
    """Which pairs of different frames show (nearly) the same pattern and may change places."""
    sample = np.random.default_rng(0).permutation(patterns.pixels)[:_ALIKE_PIXELS]
    shown = patterns.columns(sample).astype(np.float64)
    power = (shown**2).sum(axis=1)
    distance = power[:, None] + power[None, :] - 2 * shown @ shown.T
    alike = distance < _ALIKE * len(sample) * shown.var(axis=0).mean()
    return np.asarray(alike & ~np.eye(len(alike), dtype=bool))


def _alike_where_seen(
    patterns: PatternSet, rows: RawRows, scale: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Which pairs of grey patterns are alike at the projector pixels that rows follow, (K, K).

    Fine stripes of nearly the same period are, in a part of the projector. Bits are never said to
    be: from swapped frames, rows choose pixels at which these bits agree.
    """
    if patterns.as_bits() is not None:
        return np.zeros((patterns.count,) * 2, bool)
    light = rows.light(np.arange(patterns.count))
    places = best_pixels(patterns, scale, light - light.mean(axis=1, keepdims=True))
    shown = patterns.columns(places).astype(np.float64)
    shown -= shown.mean(axis=1, keepdims=True)
    length = np.maximum(np.sqrt((shown**2).sum(axis=1)), 1e-9)
    alike = shown @ shown.T > _LIKE * np.outer(length, length)
    return np.asarray(alike & ~np.eye(len(alike), dtype=bool))


def _varied(patterns: PatternSet) -> NDArray[np.bool_]:
    """Which patterns differ between pixels, (K,)."""
    spread = [np.ptp(block, axis=1) for _, block in patterns.chunks()]
    return np.asarray(np.concatenate(spread) > _ONE_GREY)


def _describe_run(start: int, stop: int, step: int, count: int, name: Name) -> str:
    which = "after" if step > 0 else "before"
    # The frame without a neighbour on that side cannot be displaced with the others.
    if start <= (step < 0) and stop >= count - 1 - (step > 0):
        return (
            f"the images do not follow the patterns: each image shows the pattern {which} its own"
        )
    question = "is one missing" if step > 0 else "is one extra"
    return (
        f"from {name(start)} to {name(stop)}, each image shows the pattern {which} its own: "
        f"{question}?"
    )
