"""Which photograph is missing, or too many, where their number is not that of the patterns.

Every place is tried at which one may be missing: the photographs before it belong to their own
pattern, those after it to the next. Of single projector pixels, one follows the samples of a camera
pixel best where the place is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.local import predict
from lightmatrix.diagnosis.pairs import Pairs, missing_of_pairs
from lightmatrix.diagnosis.rows import lively_rows
from lightmatrix.diagnosis.survey import Survey

_FEWEST_FRAMES = 12
# Multiplications; about two seconds.
_WORK = 4e9
_FEW_ROWS, _ROWS = 24, 96
_PIXELS = 512
# Places around the likeliest one that are compared by what they predict, and how well (logarithm of
# the miss) rows must be predicted to name one.
_NEAR, _PREDICTED = 3, -1.0


def gaps(paths: Sequence[Path]) -> list[str]:
    """Numbers that are missing in the names of files that are numbered one by one."""
    digits = [("".join(c for c in path.stem if c.isdecimal() and c.isascii())) for path in paths]
    if not all(digits):
        return []
    numbers = [int(each) for each in digits]
    absent = sorted(set(range(min(numbers), max(numbers) + 1)) - set(numbers))
    # Names that count in steps have no gaps.
    return [str(number) for number in absent] if len(absent) <= len(numbers) // 4 else []


def missing_places(survey: Survey) -> tuple[int, ...]:
    """Which of K patterns may have no frame, told from the K - 1 frames; empty if unknown.

    Parameters
    ----------
    survey : Survey
        Its patterns number one more than its frames.
    """
    patterns, count = survey.patterns, survey.count
    if count < _FEWEST_FRAMES:
        return ()
    first = replace(survey, patterns=patterns.subset(np.arange(count)))
    rows = lively_rows(first)
    if len(rows) < _FEW_ROWS:
        return ()
    pairs = Pairs.find(patterns)
    if pairs is not None:
        return missing_of_pairs(survey, pairs, rows)
    rows = np.random.default_rng(0).permutation(rows)
    few = rows[: int(np.clip(_WORK / (2 * count * patterns.pixels), _FEW_ROWS, _ROWS))]
    guess = int(_followed(survey, survey.samples(few)).argmax())
    best: tuple[float, tuple[int, ...]] = (_PREDICTED, ())
    samples = survey.samples(rows[:_ROWS])
    for place in range(max(0, guess - _NEAR), min(count, guess + _NEAR) + 1):
        shown = patterns.subset(np.delete(np.arange(count + 1), place))
        miss = float(np.median(np.log(predict(shown, samples).miss)))
        best = min(best, (miss, (place,)))
    return best[1]


def _followed(survey: Survey, samples: Samples) -> NDArray[np.float64]:
    """How well single projector pixels follow the samples if a frame is missing at each place."""
    patterns, count = survey.patterns, survey.count
    values = np.where(samples.clipped, np.nan, samples.values)
    mean = np.nanmean(values, axis=1, keepdims=True)
    light = np.nan_to_num(values - mean).astype(np.float32)
    best = np.zeros((count + 1, len(light)), np.float32)
    for start in range(0, patterns.pixels, _PIXELS):
        shown = patterns.columns(np.arange(start, min(start + _PIXELS, patterns.pixels)))
        shown = shown - shown.mean(axis=0)
        spread = np.sqrt((shown**2).sum(axis=0))
        shown = shown / np.where(spread < 1e-3 * np.sqrt(count), np.inf, spread)
        total = light @ shown[1:]
        for place in range(count + 1):
            # From here on the frame before `place` shows its own pattern, not the next.
            if place:
                total += light[:, place - 1 : place] * (shown[place - 1] - shown[place])
            np.maximum(best[place], total.max(axis=1), out=best[place])
    power = np.maximum((light**2).sum(axis=1), 1e-12)
    explained = np.minimum(best.astype(np.float64) ** 2 / power, 0.999)
    return np.asarray(-np.log1p(-explained).mean(axis=1))


def check_counts(survey: Survey | None, patterns: int, images: Sequence[Path]) -> Finding:
    """Say that the numbers differ, and which photograph is missing if that can be told.

    Parameters
    ----------
    survey : Survey, optional
        Of all frames; its patterns are all of them. None if they cannot be decoded.
    patterns : int
        Number of patterns.
    images : sequence of Path
        Files of the photographs.
    """
    count = len(images)
    message = f"{patterns} patterns, but {count} photographs"
    absent = gaps(images)
    frames = missing_places(survey) if survey is not None and count == patterns - 1 else ()
    if frames:
        which = " or ".join(f"{place} (the {_ordinal(place + 1)})" for place in frames)
        message += f": the one of pattern {which} is missing"
        if len(frames) == 1 and frames[0] < count:
            message += f", before {images[frames[0]].name}"
    elif absent:
        named = ", ".join(absent[:5])
        message += f"; their names leave out number {named}"
    advice = (
        "take it again, or leave the pattern out too"
        if count < patterns
        else "remove what is no photograph of a pattern: a test shot, a frame taken twice, the "
        "black frame (--black)?"
    )
    return Finding("counts", frames, message, advice)


def _ordinal(number: int) -> str:
    endings = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else endings.get(number % 10, 'th')}"
