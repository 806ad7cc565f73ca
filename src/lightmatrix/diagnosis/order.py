"""Whether the frames follow the patterns, told from the samples alone.

What each of some bright pixels should show under each pattern is predicted from the other frames
(see `frame_prediction`). An observed frame that the prediction of its own pattern misses and that
of another pattern meets is out of place.

A lost frame displaces all later ones, so that few frames are left to explain a pixel from. Hence
frames displaced by one up to or from some place on, and frames in reverse, are assumed first, and
pixels explained from the frames as the likeliest assumption has them.

Diffuse scenes and very few patterns predict no frame, and then nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.prediction import (
    PROJECTOR_PIXELS,
    Assumption,
    Misses,
    Rows,
    column_scale,
    folds,
    likeliest_assumption,
    prediction_misses,
)
from lightmatrix.patterns.pattern_set import PatternSet

# A frame alone is out of place if another prediction misses it by less than this share of what
# its own prediction does, and of what no prediction at all (the row's mean) does.
_DECISIVE = 0.45
_INFORMATIVE = 0.6
# Two frames that meet each other's predictions need less each.
_DECISIVE_OF_TWO = 0.6
_INFORMATIVE_OF_TWO = 0.7
# Frames displaced alike support each other: the mean of log(own miss / other miss), and its sum.
_RUN_MEAN = 0.25
_RUN_SUM = 2.5
_SHORTEST_RUN = 3
# No frame says more than this, for or against.
_MOST_SAID = 1.5
# Predictions that miss the usual frame by more than this share of its variance accuse none.
_PREDICTED = 0.8
# Patterns that vary by less, after binning or not, are one grey.
_ONE_GREY = 1e-3
_FEWEST_FRAMES = 12
_MOST_ROWS = 200
# Multiplications spent on predictions from one assumption; about a second.
_WORK = 2e10


@dataclass(frozen=True)
class Disorder:
    """Frames that do not follow the patterns.

    Parameters
    ----------
    frames : tuple of int
        The frames that show the pattern of another.
    message : str
        What is wrong with them.
    """

    frames: tuple[int, ...]
    message: str


def find_disorder(
    patterns: PatternSet,
    tiles: Iterable[tuple[int, Samples]],
    rows: int,
    name: Callable[[int], str] = "frame {}".format,
) -> Disorder | None:
    """Look for frames that are swapped, shifted or reversed against the patterns.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    tiles : iterable of (int, Samples)
        Samples (m, K) of all camera rows, tile by tile.
    rows : int
        Number of camera rows M.
    name : callable
        What to call the frame of an index.

    Returns
    -------
    Disorder, optional
        None if nothing is known to be wrong.
    """
    if patterns.count < _FEWEST_FRAMES:
        return None
    samples = _bright_rows(patterns, tiles, rows)
    return None if samples is None else _disorder(patterns, samples, name)


def _disorder(patterns: PatternSet, rows: Rows, name: Callable[[int], str]) -> Disorder | None:
    """What is wrong with the frames; None if nothing is known to be."""
    count = patterns.count
    frames = np.arange(count)
    scale = column_scale(patterns)
    alike = _alike(patterns)
    as_named = Assumption(frames, frames)
    plain = prediction_misses(patterns, rows, as_named, scale)
    # A pattern that is one grey says nothing of which pixels were lit, while its photograph may
    # well vary: with stripes finer than a bin, or where white clips.
    plain = replace(plain, telling=plain.telling & _varied(patterns))
    guess = likeliest_assumption(patterns, rows)
    if guess is not None and (guess.order == frames[::-1]).all():
        other = prediction_misses(patterns, rows, guess, scale)
        gain = np.minimum(plain.own, other.own) - other.logarithms[frames, guess.order]
        gain[alike[frames, guess.order] | ~plain.telling] = 0
        if _predictive(other, guess.order) and _supported(gain, 0, count):
            words = (
                "the images do not follow the patterns: the images follow the patterns backwards"
            )
            return Disorder(tuple(range(count)), words)
    for first in (guess, as_named):
        found = first and _displaced_run(patterns, rows, first, plain, alike, scale)
        if found:
            start, stop, _ = found
            return Disorder(tuple(range(start, stop + 1)), _describe_run(*found, count, name))
    displaced = _displaced_singly(patterns, rows, plain, alike, scale)
    said = _describe_single(displaced, name)
    return None if said is None else Disorder(tuple(displaced), said)


def _displaced_run(
    patterns: PatternSet,
    rows: Rows,
    assumption: Assumption,
    plain: Misses,
    alike: NDArray[np.bool_],
    scale: NDArray[np.float32],
) -> tuple[int, int, int] | None:
    """First, last frame and step of the frames that show the pattern `step` after their own."""
    frames = np.arange(patterns.count)
    misses = plain
    for last_look in (False, True):
        if not (assumption.order == frames).all():
            misses = prediction_misses(patterns, rows, assumption, scale)
        own = np.minimum(plain.own, misses.own)
        predictive = _predictive(misses, assumption.order)
        best: tuple[float, int, int, int] = (0.0, 0, 0, 0)
        for step in (1, -1):
            shown = np.clip(frames + step, 0, patterns.count - 1)
            gain = own - misses.logarithms[frames, shown]
            gain[(shown == frames) | alike[frames, shown] | ~plain.telling] = 0
            start, stop = _richest_run(np.clip(gain, -_MOST_SAID, _MOST_SAID) - 0.1)
            if not last_look or (predictive and _supported(gain, start, stop)):
                best = max(best, (float(gain[start:stop].sum()), start, stop, step))
        _, start, stop, step = best
        if stop - start < _SHORTEST_RUN:
            return None
        if last_look:
            return start, stop - 1, step
        # Once more, from frames as they now seem to be.
        run = frames[start:stop]
        order, taken = frames.copy(), frames.copy()
        order[run] = run + step
        if misses.elsewhere[run, run + step].mean() > 0.5:
            taken[run] = run + step
        assumption = Assumption(order, taken)
    return None


def _richest_run(gain: NDArray[np.float64]) -> tuple[int, int]:
    """The frames start..stop of the largest sum."""
    total = np.append(0, np.cumsum(gain))
    lowest = np.minimum.accumulate(total)
    stop = int((total - lowest).argmax())
    return int(total[: stop + 1].argmin()), stop


def _supported(gain: NDArray[np.float64], start: int, stop: int) -> bool:
    some = np.clip(gain[start:stop], -_MOST_SAID, _MOST_SAID)
    return len(some) >= _SHORTEST_RUN and some.mean() > _RUN_MEAN and some.sum() > _RUN_SUM


def _predictive(misses: Misses, order: NDArray[np.int64]) -> bool:
    """Whether most frames are met by the predictions for the patterns they are taken to show."""
    met = misses.logarithms[np.arange(len(order)), order]
    return bool(np.median(met[(order >= 0) & misses.telling]) < np.log(_PREDICTED))


def _displaced_singly(
    patterns: PatternSet,
    rows: Rows,
    plain: Misses,
    alike: NDArray[np.bool_],
    scale: NDArray[np.float32],
) -> dict[int, tuple[int, bool]]:
    """Which frame shows the pattern of which other frame, and whether that is clear by itself."""
    frames = np.arange(patterns.count)
    suspicion = plain.own - _others(plain, alike).min(axis=1)
    suspects = np.argsort(-suspicion)[: patterns.count // 6]
    suspects = suspects[(suspicion[suspects] > 0.2) & plain.telling[suspects]]
    if not len(suspects):
        return {}
    # Judged by what the frames say that are not suspected.
    order = frames.copy()
    order[suspects] = -1
    misses = prediction_misses(patterns, rows, Assumption(order, frames), scale)
    if not _predictive(misses, order):
        return {}
    others = _others(misses, alike)
    own = np.minimum(plain.own, misses.own)
    nearest = others.argmin(axis=1)
    result = {}
    for k in np.sort(suspects):
        s = nearest[k]
        gain, reached = own[k] - others[k, s], others[k, s]
        clear = gain > -np.log(_DECISIVE) and reached < np.log(_INFORMATIVE)
        back = own[s] - others[s, k]
        both = gain + back > -2 * np.log(_DECISIVE_OF_TWO) and max(reached, others[s, k]) < np.log(
            _INFORMATIVE_OF_TWO
        )
        if clear or (both and min(gain, back) > 0.2):
            result[int(k)] = (int(s), bool(both))
    return result


def _others(misses: Misses, alike: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(alike | np.eye(len(alike), dtype=bool), np.inf, misses.logarithms)


def _bright_rows(
    patterns: PatternSet, tiles: Iterable[tuple[int, Samples]], rows: int
) -> Rows | None:
    """Some of the rows that vary most, in random order; None if hardly any varies."""
    cost = patterns.count * patterns.pixels * folds(patterns.count) * PROJECTOR_PIXELS
    wanted = int(np.clip(_WORK / cost, 24, _MOST_ROWS))
    generator = np.random.default_rng(0)
    found, levels = [], []
    for _, tile in tiles:
        level = np.broadcast_to(tile.clip_level, tile.values.shape)
        values = np.minimum(tile.values, level.min(axis=1, keepdims=True))
        spread = values.std(axis=1)
        share = -(-wanted * len(values) // rows)
        # A random choice among the better third: the very best are often all in one place.
        better = np.argsort(-spread)[: max(share, len(values) // 3)]
        pick = generator.permutation(better)[:share]
        pick = pick[spread[pick] > 0]
        found.append(tile.values[pick] / level[pick])
        levels.append(level[pick])
    shares, levels_of = np.concatenate(found), np.concatenate(levels)
    if len(shares) < 16:
        return None
    mixed = generator.permutation(len(shares))
    return Rows(shares[mixed], levels_of[mixed])


def _alike(patterns: PatternSet) -> NDArray[np.bool_]:
    """Which pairs of different frames show (nearly) the same pattern and may change places."""
    sample = np.random.default_rng(0).permutation(patterns.pixels)[:4096]
    shown = patterns.columns(sample).astype(np.float64)
    power = (shown**2).sum(axis=1)
    distance = power[:, None] + power[None, :] - 2 * shown @ shown.T
    alike = distance < 0.02 * len(sample) * shown.var(axis=0).mean()
    return np.asarray(alike & ~np.eye(len(alike), dtype=bool))


def _varied(patterns: PatternSet) -> NDArray[np.bool_]:
    """Which patterns differ between pixels, (K,)."""
    spread = [np.ptp(block, axis=1) for _, block in patterns.chunks()]
    return np.asarray(np.concatenate(spread) > _ONE_GREY)


def _describe_run(start: int, stop: int, step: int, count: int, name: Callable[[int], str]) -> str:
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


def _describe_single(
    displaced: dict[int, tuple[int, bool]], name: Callable[[int], str]
) -> str | None:
    if not displaced:
        return None
    swapped = sorted({(min(k, s), max(k, s)) for k, (s, both) in displaced.items() if both})
    if swapped:
        pairs = ", ".join(f"{name(k)} and {name(s)}" for k, s in swapped[:5])
        return f"{pairs} look swapped"
    # One image alone is displaced when it repeats another, or when its partner is unclear.
    frame, (shown, _) = next(iter(displaced.items()))
    return f"{name(frame)} shows the pattern of {name(shown)}: is it swapped, repeated or late?"
