"""Whether each frame shows its own pattern, and which photograph is missing, by the samples alone.

A frame that is lost, or there twice, displaces all later ones, which leaves few frames to predict
from. So the place is looked for from which on single projector pixels follow the frames best if
each shows the pattern after or before its own. Predictions made as if that were so confirm it, and
find the place to the frame. Single frames are out of place if they miss the prediction for their
own pattern and meet that for another.

Where exposures differ, a displaced frame may have been taken with the exposure of its place, as
when the projector was late, or with that of the frame it really is, as when a file is missing.
Both readings are tried.

Diffuse scenes and very few patterns predict no frame; then nothing is claimed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.check.code_order import CodeLattice, missing_of_code
from lightmatrix.check.finding import WRONG_ORDER, Finding
from lightmatrix.check.prediction import FramePrediction, predict
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import work_ahead

Order = NDArray[np.int64]
Values = NDArray[np.floating]

# No place is inferred from fewer frames or camera pixels.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 24


def check_run(survey: Survey, rows: Order, name: Callable[[int], str]) -> list[Finding]:
    """Whether all frames from some one on show the pattern after, or before, their own.

    `rows` are high-variance rows.
    """
    count, frames = survey.count, np.arange(survey.count)
    if count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return []
    rows = np.random.default_rng(0).permutation(rows)[:96]
    several = np.ptp(survey.decoder.exposure) > 0
    found, most = list[Finding](), 0.0
    for step in (1, -1):
        shown = _displaced(frames, 0, step, count)
        for exposed_as in (frames, shown) if several else (frames,):
            moved = replace(survey, decoder=survey.decoder.select(exposed_as)).samples(rows)
            samples = survey.samples(rows)
            guess = _likely_place(survey.patterns, samples, moved, step)
            # A run has at least three frames.
            if guess > count - 3:
                continue
            places = range(max(0, guess - 2), min(count - 3, guess + 2) + 1)
            misses = _misses(survey.patterns, samples, moved, step, [*places, count])
            start = min(places, key=lambda place: float(misses[place].mean()))
            gain = misses[count] - misses[start]
            # Better by 4 standard errors, as for motion.
            if gain.mean() <= max(0.15, 4 * float(gain.std()) / np.sqrt(len(gain)), most):
                continue
            most = float(gain.mean())
            which = f"each image shows the pattern {'after' if step > 0 else 'before'} its own"
            message = (
                f"from {name(start)} to {name(count - 1)}, {which}: is one "
                f"{'missing' if step > 0 else 'extra'}?"
            )
            # The first frame has no pattern before its own.
            if start <= (step < 0):
                message = f"the images do not follow the patterns: {which}"
            found = [Finding("order", tuple(range(start, count)), message, WRONG_ORDER)]
    return found


def suspected_frames(survey: Survey, rows: Order) -> NDArray[np.bool_]:
    """Frames that meet the prediction for another pattern better than that for their own, (K,).

    Frames never predict themselves here, not even through the choice of windows: from few frames,
    some window explains any of them.
    """
    patterns, count = survey.patterns, survey.count
    suspects = np.zeros(count, bool)
    if count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return suspects
    folds = 8 if count <= 64 else 4
    # The work is bounded to about a second.
    wanted = int(np.clip(1e10 / (count * patterns.pixels * folds), 24, 120))
    samples = survey.samples(np.random.default_rng(0).permutation(rows)[:wanted])
    fold = np.random.default_rng(0).permutation(count) % folds
    parts = [predict(patterns, samples, doubted=fold == part) for part in range(folds)]
    expected = np.stack([parts[part].expected[:, k] for k, part in enumerate(fold)], axis=1)
    lowest = samples.clip_levels_of_all().min(axis=1, keepdims=True)
    miss = misses_of_each(replace(parts[0], expected=expected), lowest)
    least = miss.min(axis=1)
    better = least / np.diag(miss)
    # The other frames must predict them. By predictions that are worse than the mean of all frames,
    # some other pattern always seems better.
    worst = np.argsort(better)[: count // 6]
    suspects[worst[(better[worst] < 0.8) & (least[worst] < 1)]] = True
    return suspects


def misses_of_each(prediction: FramePrediction, lowest: Values) -> NDArray[np.float64]:
    """How far each frame (row) is from what is predicted for each pattern, (K, K).

    Whatever the frame's brightness; as a share of how far it is from the mean of all frames.
    `lowest` (m, 1) is the level up to which every frame measures the light.
    """
    scale = np.maximum(prediction.observed.std(axis=1, keepdims=True), 1e-12)
    observed, expected = (
        np.minimum(each, lowest) / scale for each in (prediction.observed, prediction.expected)
    )
    columns = (observed, expected, observed.mean(axis=1, keepdims=True))
    seen, own, usual = (each / np.maximum(np.linalg.norm(each, axis=0), 1e-12) for each in columns)
    return np.asarray((1 - (seen.T @ own) ** 2) / np.maximum(1 - (seen.T @ usual) ** 2, 1e-9))


def shown_instead(miss: NDArray[np.float64], suspects: NDArray[np.bool_]) -> dict[int, int]:
    """Which of the suspected frames (K,) show the pattern of which other frame.

    By the misses (K, K) of a prediction that learned from no suspect.
    """
    others = miss + np.where(np.eye(len(miss)) > 0, np.inf, 0)
    best = others.argmin(axis=1)
    # How much better the best other pattern is than the own one, and than any third one.
    least, third = np.sort(others, axis=1)[:, :2].T
    share = least / np.minimum(np.diag(miss), third)
    shown: dict[int, int] = {}
    for k in map(int, np.flatnonzero(suspects)):
        s = int(best[k])
        # Chosen on simulated captures: `python -m benchmarks.frame_checks`. Two frames that meet
        # each other's predictions need less.
        if best[s] == k and share[k] * share[s] < 0.65**2:
            shown |= {k: s, s: k}
        elif share[k] < 0.5 and least[k] < 0.6 and k not in shown:
            shown[k] = s
    return shown


def _displaced(frames: Order, place: int, step: int, count: int) -> Order:
    """Which of `count` patterns each frame shows if those from a place on are displaced."""
    return np.clip(frames + step * (frames >= place), 0, count - 1)


def _misses(
    patterns: PatternSet, samples: Samples, moved: Samples, step: int, places: Sequence[int]
) -> dict[int, NDArray[np.float64]]:
    """What the prediction of each row misses, (m,), if frames are displaced from a place on."""
    frames, result = np.arange(samples.values.shape[1]), {}
    for place in places:
        late = frames >= place
        parts = ((s.values, s.clipped, s.clip_levels_of_all()) for s in (moved, samples))
        read = Samples(*(np.where(late, a, b) for a, b in zip(*parts, strict=True)))
        shown = patterns.subset(_displaced(frames, place, step, patterns.count))
        result[place] = np.log(np.maximum(predict(shown, read).miss, 1e-9))
    return result


def _likely_place(patterns: PatternSet, samples: Samples, moved: Samples, step: int) -> int:
    """From which frame on single pixels follow displaced frames best; K if none is displaced.

    `samples` and `moved` are readings of the same frames (m, K) as they are and once displaced. All
    frames count wherever the place is, so chance raises the correlation of the best pixel alike for
    all places.
    """
    count = samples.values.shape[1]
    # The work is bounded to about a second.
    rows = slice(int(np.clip(2.5e9 / (patterns.count * patterns.pixels), 24, 96)))
    lowest = samples.clip_levels_of_all().min(axis=1, keepdims=True)
    centre = np.minimum(samples.values, lowest).mean(axis=1, keepdims=True)

    def light(read: Samples) -> NDArray[np.float32]:
        values = (np.minimum(read.values, lowest) - centre)[rows]
        # The brightness of a frame (flicker, the mean of its pattern) is no evidence of its pixels.
        return np.asarray(values - values.mean(axis=0), np.float32)

    coarse = np.unique(np.linspace(0, count, 17).astype(int))
    best = int(coarse[_followed(patterns, light(samples), light(moved), step, coarse).argmax()])
    reach = -(-count // 16)
    near = np.arange(max(0, best - reach), min(count, best + reach) + 1)
    return int(near[_followed(patterns, light(samples), light(moved), step, near).argmax()])


def _followed(
    patterns: PatternSet, light: Values, moved: Values, step: int, places: Order
) -> NDArray[np.float64]:
    """How well single pixels follow samples (m, K) displaced from each place on, (places,).

    The mean over the rows of -log(1 - the share of the variance that the best pixel explains).
    """
    shown = _displaced(np.arange(light.shape[1]), 0, step, patterns.count)

    def largest(start: int) -> Values:
        """The largest sums over 1024 pixels, as many as caches hold, (places, m)."""
        columns = patterns.span(start, min(start + 1024, patterns.pixels))
        columns = columns - columns.mean(axis=0)
        norm = np.sqrt((columns**2).sum(axis=0))
        # Pixels that are constant over the patterns count nothing.
        lit = columns / np.where(norm < 1e-3 * np.sqrt(patterns.count), np.inf, norm)
        total = moved @ lit[shown]
        result = np.empty((len(places), len(light)), np.float32)
        for i, (a, b) in enumerate(itertools.pairwise([0, *places])):
            total += light[:, a:b] @ lit[a:b] - moved[:, a:b] @ lit[shown[a:b]]
            result[i] = total.max(axis=1)
        return result

    best = reduce(np.maximum, work_ahead(largest, range(0, patterns.pixels, 1024)))
    power = np.stack(
        [(light[:, :at] ** 2).sum(axis=1) + (moved[:, at:] ** 2).sum(axis=1) for at in places]
    )
    share = np.maximum(best, 0) ** 2 / np.maximum(power, 1e-12)
    return np.asarray(-np.log1p(-np.minimum(share, 0.999)).mean(axis=1), np.float64)


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
    if count < _FEWEST_FRAMES:
        return ()
    rows = high_variance_rows(replace(survey, patterns=patterns.subset(np.arange(count))))
    if len(rows) < _FEWEST_ROWS:
        return ()
    # The frames after the missing one show the pattern after that of their number.
    samples = survey.samples(np.random.default_rng(0).permutation(rows)[:96])
    guess = _likely_place(patterns, samples, samples, 1)
    near = range(max(0, guess - 3), min(count, guess + 3) + 1)
    usual = {
        k: float(np.median(v)) for k, v in _misses(patterns, samples, samples, 1, near).items()
    }
    best = min(usual, key=usual.__getitem__)
    # Predictions must miss less than this share of the median row's variance.
    return (best,) if usual[best] < np.log(0.37) else ()
