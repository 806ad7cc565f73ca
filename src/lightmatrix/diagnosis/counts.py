"""Which photograph is missing, or that there are too many, where patterns and photographs differ.

Every place at which one may be missing is tried: the photographs before it belong to their own
pattern, those after it to the next. Single projector pixels follow the samples of the camera pixels
best if the place is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.inverse_pairs import Pairs, missing_of_pairs
from lightmatrix.diagnosis.order_hypotheses import explained, normalized_columns
from lightmatrix.diagnosis.prediction import predict
from lightmatrix.diagnosis.survey import Survey, high_variance_rows
from lightmatrix.patterns.pattern_set import PatternSet

# The fewest frames and rows from which a missing frame is inferred.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 24
# The scan over all places uses 24 to 96 rows, as many as 4e9 multiplications allow (about two
# seconds), and 512 projector pixels at a time, so that sums stay in the processor's cache.
_WORK, _MOST_ROWS = 4e9, 96
_PIXELS_AT_ONCE = 1 << 9
# Places up to 3 from the likeliest one are compared by predictions. The best is named if the median
# row misses less than exp(-1) = 37 % of its variance.
_NEAR, _MOST_MISSED = 3, -1.0
# Names count in steps, and have no gaps, if they leave out more than a quarter of their numbers.
_FEWEST_PER_GAP = 4


def check_counts(survey: Survey | None, patterns: int, images: Sequence[Path]) -> Finding:
    """State that the numbers differ, and, with a survey of all, which photograph is missing."""
    count = len(images)
    message = f"{patterns} patterns, but {count} photographs"
    gaps = _missing_numbers(images)
    frames = missing_places(survey) if survey is not None and count == patterns - 1 else ()
    if frames:
        which = " or ".join(f"{place} (the {_ordinal(place + 1)})" for place in frames)
        message += f": the one of pattern {which} is missing"
        if len(frames) == 1 and frames[0] < count:
            message += f", before {images[frames[0]].name}"
    elif gaps:
        message += f"; their names leave out number {', '.join(gaps[:5])}"
    advice = (
        "take it again, or leave the pattern out too"
        if count < patterns
        else "remove what is no photograph of a pattern: a test shot, a frame taken twice, the "
        "black frame (--black)?"
    )
    return Finding("counts", frames, message, advice)


def missing_places(survey: Survey) -> tuple[int, ...]:
    """Which of K patterns may have no frame among K - 1 frames; empty if unknown."""
    patterns, count = survey.patterns, survey.count
    if count < _FEWEST_FRAMES:
        return ()
    rows = high_variance_rows(replace(survey, patterns=patterns.subset(np.arange(count))))
    if len(rows) < _FEWEST_ROWS:
        return ()
    pairs = Pairs.find(patterns)
    if pairs is not None:
        return missing_of_pairs(survey, pairs, rows)
    rows = np.random.default_rng(0).permutation(rows)
    few = rows[: int(np.clip(_WORK / (2 * count * patterns.pixels), _FEWEST_ROWS, _MOST_ROWS))]
    guess = int(_scores_by_place(patterns, survey.samples(few)).argmax())
    best: tuple[float, tuple[int, ...]] = (_MOST_MISSED, ())
    samples = survey.samples(rows[:_MOST_ROWS])
    for place in range(max(0, guess - _NEAR), min(count, guess + _NEAR) + 1):
        shown = patterns.subset(np.delete(np.arange(count + 1), place))
        miss = float(np.median(np.log(predict(shown, samples).miss)))
        best = min(best, (miss, (place,)))
    return best[1]


def _scores_by_place(patterns: PatternSet, samples: Samples) -> NDArray[np.float64]:
    """How well single pixels follow K - 1 frames if the frame of each of K patterns is missing."""
    values = np.where(samples.clipped, np.nan, samples.values)
    mean = np.nanmean(values, axis=1, keepdims=True)
    light = np.nan_to_num(values - mean).astype(np.float32)
    best = np.zeros((patterns.count, len(light)), np.float32)
    for start in range(0, patterns.pixels, _PIXELS_AT_ONCE):
        stop = min(start + _PIXELS_AT_ONCE, patterns.pixels)
        shown = normalized_columns(patterns, start, stop)
        total = light @ shown[1:]
        for place in range(patterns.count):
            # From here on the frame before `place` shows its own pattern, not the next.
            if place:
                total += light[:, place - 1 : place] * (shown[place - 1] - shown[place])
            np.maximum(best[place], total.max(axis=1), out=best[place])
    power = np.maximum((light**2).sum(axis=1), 1e-12)
    return explained(best.astype(np.float64) ** 2 / power)


def _missing_numbers(paths: Sequence[Path]) -> list[str]:
    """Numbers that are missing in the names of files that are numbered one by one."""
    digits = [("".join(c for c in path.stem if c.isdecimal() and c.isascii())) for path in paths]
    if not all(digits):
        return []
    numbers = [int(each) for each in digits]
    absent = sorted(set(range(min(numbers), max(numbers) + 1)) - set(numbers))
    return (
        [str(number) for number in absent] if _FEWEST_PER_GAP * len(absent) <= len(numbers) else []
    )


def _ordinal(number: int) -> str:
    endings = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else endings.get(number % 10, 'th')}"
