"""Captures in which most patterns come with their inverse, as Gray codes do.

A pattern and its inverse add up to white, so the photographs of every pair add up to one and the
same image, whatever the pattern. That reveals more, and more exactly, than any prediction: an odd
frame, light that changed and motion show as differences between the sums of pairs. Sums cannot tell
which of two pairs is which; for that, neighbouring camera pixels must see neighbouring projector
pixels.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.check.finding import STEADY_LIGHT, Finding, odd_light, order_findings
from lightmatrix.check.motion import find_shift, motion_finding
from lightmatrix.check.prediction import find_places
from lightmatrix.check.survey import (
    MARGIN,
    Survey,
    bright_mean,
    random_sums,
    robust_deviation,
)
from lightmatrix.check.wrong_frames import black_frames
from lightmatrix.patterns.pattern_set import PatternSet

# A pair is odd if its sum differs by this share from the usual one, and by 4 times what that of the
# median pair does.
_ODD = 0.15

Pair = tuple[int, int]


@dataclass(frozen=True)
class Pairs:
    """The two frames of each pattern and its inverse, and the frames that are in no pair."""

    pairs: tuple[Pair, ...]
    others: tuple[int, ...]

    @classmethod
    def find(cls, patterns: PatternSet) -> Pairs | None:
        """The pairs of a set; None if most patterns have no inverse."""
        sums, white = random_sums(patterns)
        left = list(range(patterns.count))
        pairs: list[Pair] = []
        while left:
            k = left.pop(0)
            # Sums are exact but for rounding; those of two other patterns are off by about 1.
            inverse = next((j for j in left if abs(sums[k] + sums[j] - white) < 1e-4), None)
            if inverse is not None:
                left.remove(inverse)
                pairs.append((k, inverse))
        if 2 * len(pairs) < 0.6 * patterns.count or len(pairs) < 4:
            return None
        # Black and white are a pair that tells nothing more.
        uniform = [pair for pair in pairs if np.ptp(patterns.rows(pair[0], pair[0] + 1)) < 0.02]
        paired = {k for pair in pairs for k in pair}
        others = [k for k in range(patterns.count) if k not in paired]
        others += [k for pair in uniform for k in pair]
        return cls(tuple(pair for pair in pairs if pair not in uniform), tuple(others))


@dataclass(frozen=True, eq=False)
class PairSums:
    """Sums of the two samples of each pair, of m high-variance rows."""

    pairs: tuple[Pair, ...]
    samples: Samples

    def sum_of(self, j: int, k: int) -> NDArray[np.float64]:
        """The sum of two frames, (m,); NaN where one is clipped."""
        clipped = self.samples.clipped[:, j] | self.samples.clipped[:, k]
        both = self.samples.values[:, j].astype(np.float64) + self.samples.values[:, k]
        return np.where(clipped, np.nan, both)

    @cached_property
    def usual(self) -> NDArray[np.float64]:
        """The median of what pairs add up to, (m,); NaN where one of each pair is clipped."""
        sums = np.stack([self.sum_of(j, k) for j, k in self.pairs])
        known = ~np.isnan(sums).all(axis=0)
        usual = np.full(sums.shape[1], np.nan)
        usual[known] = np.nanmedian(sums[:, known], axis=0)
        return usual

    def oddness(self, j: int, k: int) -> float:
        """How far two frames are from adding up to white, as a share of it."""
        relative = (self.sum_of(j, k) - self.usual) / np.maximum(self.usual, 1e-6)
        # Nothing is known of a pair of which one frame clips in all pixels.
        known = np.clip(relative[~np.isnan(relative)], -1, 1)
        return float(np.sqrt((known**2).sum() / max(len(known), 1)))

    @cached_property
    def limit(self) -> float:
        """The oddness from which on a pair is odd."""
        return max(_ODD, 4 * float(np.median([self.oddness(j, k) for j, k in self.pairs])))

    @property
    def odd(self) -> list[Pair]:
        """The pairs that do not add up to white."""
        return [pair for pair in self.pairs if self.oddness(*pair) > self.limit]

    def gain(self, frame: int, partner: int) -> tuple[float, float]:
        """How much brighter a frame is than its partner lets expect, as a share, and its error."""
        expected, usual = self.usual - self.samples.values[:, partner], np.nan_to_num(self.usual)
        # In dim pixels, noise decides which of the two frames is the brighter one.
        lit = (expected > 0.6 * usual) & (usual > 0.2 * bright_mean(usual))
        lit &= ~self.samples.clipped[:, frame]
        if lit.sum() < 20:
            return 0.0, np.inf
        # However many they are, they are only as exact as cameras are linear.
        light, total = expected[lit], expected[lit].sum()
        change = self.samples.values[lit, frame] - light
        gain = float(change.sum() / total)
        return gain, float(np.hypot(0.004, np.linalg.norm(change - gain * light) / total))

    def black_frame(self, pair: Pair) -> int | None:
        """The frame of a pair that is dark where its partner is dark too."""
        for frame, partner in (pair, pair[::-1]):
            expected = np.nansum(np.maximum(self.usual - self.samples.values[:, partner], 0))
            light = float(np.nansum(self.samples.values[:, frame]))
            other = float(np.nansum(self.samples.values[:, partner]))
            # It has less than 10 % of the light that its partner lets expect, but for stray light.
            if light < 0.1 * float(expected) + 0.05 * other and light < 0.3 * other:
                return frame
        return None


def check_pairs(
    survey: Survey, rows: NDArray[np.int64], pairs: Pairs, names: Sequence[str]
) -> tuple[list[Finding], Survey, NDArray[np.bool_]]:
    """Order, single frames and motion, by the sums of pairs in high-variance rows.

    Returns findings, the survey with swapped frames put right, and which frames are wrong, (K,).
    """
    doubted = np.zeros(survey.count, bool)
    findings = _check_motion(survey, pairs, names)
    if findings:
        return findings, survey, doubted
    sums = PairSums(pairs.pairs, survey.samples(rows))
    odd = list(sums.odd)
    if len(odd) > len(pairs.pairs) // 2:
        return [], survey, doubted
    for pair in list(odd):
        frame = sums.black_frame(pair)
        if frame is not None:
            odd.remove(pair)
            doubted[list(pair)] = True
            findings.append(black_frames([frame], names))
    swap = _find_swap(survey, rows, sums, odd, pairs.others)
    if swap is not None:
        survey = _swapped(survey, swap)
        odd = PairSums(pairs.pairs, survey.samples(rows)).odd
        findings += order_findings({swap[0]: swap[1], swap[1]: swap[0]}, names.__getitem__)
    for pair in odd:
        if doubted[list(pair)].all():
            continue
        doubted[list(pair)] = True
        message = (
            f"{names[pair[0]]} and {names[pair[1]]}, of a pattern and its inverse, do not add up "
            "to white: one shows something else"
        )
        advice = (
            "look at them: taken during the change of pattern, moved, covered, in another's place? "
            "Take them again"
        )
        findings.append(Finding("frame", pair, message, advice))
    return findings, survey, doubted


def pair_gains(
    survey: Survey, rows: NDArray[np.int64], pairs: Pairs, doubted: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """How much brighter frames are than their partners let expect, the errors, and which these are.

    Each is (k,).
    """
    sums = PairSums(pairs.pairs, survey.samples(rows))
    frames = [(j, k) for pair in pairs.pairs for j, k in (pair, pair[::-1]) if not doubted[j]]
    gains = np.array([sums.gain(j, k) for j, k in frames]).reshape(-1, 2)
    return gains[:, 0], gains[:, 1], np.array([j for j, _ in frames], np.int64)


def check_gains(
    change: NDArray[np.float64],
    error: NDArray[np.float64],
    frames: NDArray[np.int64],
    names: Sequence[str],
) -> list[Finding]:
    """Whether the light of some of the `frames` (k,), or of all, changes by more than its error."""
    if len(change) < 4:
        return []
    certain, usual = np.abs(change) > 5 * error, robust_deviation(change)
    # A standard deviation of the light of up to 1.2 % does no harm.
    if usual > 0.012 and certain.mean() > 0.3:
        spread = 100 * float(np.sqrt(np.mean(np.clip(change, -4 * usual, 4 * usual) ** 2)))
        # Sums of pairs that are not linear in light look like changes of the light.
        message = (
            f"the light varies from frame to frame by {spread:.1f} % (standard deviation), or the "
            "photographs are not linear in light"
        )
        return [Finding("gain", (), message, f"{STEADY_LIGHT}, or the camera's gamma")]
    odd = np.flatnonzero(certain & (np.abs(change) > max(0.04, 6 * usual)))
    if not len(odd):
        return []
    message = odd_light({names[frames[k]]: change[k] for k in odd})
    return [Finding("gain", tuple(map(int, frames[odd])), message, STEADY_LIGHT)]


def _find_swap(
    survey: Survey,
    rows: NDArray[np.int64],
    sums: PairSums,
    odd: list[Pair],
    others: tuple[int, ...],
) -> Pair | None:
    """The two frames that, exchanged, make all pairs add up to white."""
    if len(odd) not in (1, 2):
        return None

    def adds_up(order: dict[int, int]) -> bool:
        return all(sums.oddness(order.get(j, j), order.get(k, k)) < sums.limit for j, k in odd)

    swaps = itertools.product(*odd) if len(odd) == 2 else itertools.product(*odd, others)
    fitting = [(a, b) for a, b in swaps if adds_up({a: b, b: a})]
    if len(fitting) < 2:
        return fitting[0] if fitting else None
    return min(fitting, key=lambda swap: distance_of_neighbours(_swapped(survey, swap), rows))


def _swapped(survey: Survey, swap: Pair) -> Survey:
    order = np.arange(survey.count)
    order[list(swap)] = swap[::-1]
    return survey.select_frames(order)


def distance_of_neighbours(survey: Survey, rows: NDArray[np.int64]) -> float:
    """Mean logarithm of how many projector pixels apart neighbouring rows see."""
    some = rows[:: max(1, len(rows) // 100)]
    asked = [some, survey.neighbour(some, (0, MARGIN)), survey.neighbour(some, (MARGIN, 0))]
    samples = survey.samples(np.concatenate(asked))
    places = find_places(survey.patterns, samples, count=1)[0]
    here, *there = np.split(np.stack(np.divmod(places, survey.patterns.shape[1])), 3, axis=1)
    apart = [np.abs(here - other).max(axis=0) for other in there]
    return float(np.log1p(np.concatenate(apart)).mean())


def _check_motion(survey: Survey, pairs: Pairs, names: Sequence[str]) -> list[Finding]:
    """Whether the sums of pairs lie elsewhere from some pair on."""
    ordered = sorted(pairs.pairs, key=min)
    images = []
    for pair in ordered:
        image = np.empty(len(survey.raw), np.float32)
        for part, tile in survey.select_frames(np.array(pair)).chunks():
            image[part] = tile.values.sum(axis=1)
        images.append(image)
    shift = find_shift(survey, np.median(images[:3], axis=0), np.median(images[-3:], axis=0))
    if shift is None:
        return []
    moved = [find_shift(survey, images[0], image) is not None for image in images]
    if not moved[-1]:
        return []
    start = min(ordered[moved.index(True)])
    when = f"from {names[start]} on, or the frame before or after"
    return [motion_finding(when, start, shift, survey.count)]


def missing_of_pairs(survey: Survey, pairs: Pairs, rows: NDArray[np.int64]) -> tuple[int, ...]:
    """Which of K patterns has no frame among K - 1, where most patterns have inverses.

    Where nothing tells a pattern and its inverse apart, both are named.
    """
    count = survey.patterns.count
    samples = survey.samples(rows)
    oddness = []
    for place in range(count):
        frame = np.arange(count) - (np.arange(count) > place)
        pairs_left = tuple(
            (int(frame[j]), int(frame[k])) for j, k in pairs.pairs if place not in (j, k)
        )
        sums = PairSums(pairs_left, samples)
        oddness.append(float(np.mean([sums.oddness(j, k) for j, k in pairs_left])))
    best = min(oddness)
    likely = [place for place, size in enumerate(oddness) if size < 1.5 * best]
    if best > _ODD or len(likely) > 4:
        return ()
    apart = []
    for place in likely:
        shown = survey.patterns.subset(np.delete(np.arange(count), place))
        apart.append(distance_of_neighbours(replace(survey, patterns=shown), rows))
    # Two orders are equally likely if these mean logarithms differ by less than 0.2.
    return tuple(
        place for place, size in zip(likely, apart, strict=True) if size < min(apart) + 0.2
    )
