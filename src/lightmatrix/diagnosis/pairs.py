"""Captures in which most patterns come with their inverse, as Gray codes do.

A pattern and its inverse add up to white, so the photographs of every pair add up to one and the
same image, whatever the pattern. That tells more, and more exactly, than any prediction: an odd
frame, light that changed and motion show as differences between the sums of pairs. Which of two
pairs is which the sums cannot tell; there, neighbouring camera pixels must see neighbouring
projector pixels.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.local import find_places
from lightmatrix.diagnosis.outlines import agreed_shift, describe_shift
from lightmatrix.diagnosis.survey import MARGIN, Survey
from lightmatrix.patterns.pattern_set import PatternSet

# Of all frames, that must be in pairs.
_PAIRED = 0.6
# A pair whose sum differs by this share from the others', and by this many times what the usual
# pair does, is odd.
_ODD, _UNUSUAL = 0.15, 4.0
# Of the light that is expected.
_BLACK = 0.1
_FEW_ROWS = 100
# A logarithm: how much further neighbours may be apart without being jumbled.
_JUMBLED = 0.2


@dataclass(frozen=True)
class Pairs:
    """Frames of patterns and of their inverses.

    Parameters
    ----------
    of : tuple of (int, int)
        The two frames of each pair.
    others : tuple of int
        Frames that are in none.
    """

    of: tuple[tuple[int, int], ...]
    others: tuple[int, ...]

    @classmethod
    def find(cls, patterns: PatternSet) -> Pairs | None:
        """The pairs of a set; None if most patterns have no inverse."""
        mix = np.random.default_rng(0).standard_normal((1, patterns.pixels))
        seen = patterns.forward(mix)[0]
        whole = float(mix.sum())
        near = 1e-4 * np.sqrt(patterns.pixels)
        left = list(range(patterns.count))
        found = []
        while left:
            k = left.pop(0)
            inverse = next((j for j in left if abs(seen[k] + seen[j] - whole) < near), None)
            if inverse is not None:
                left.remove(inverse)
                found.append((k, inverse))
        paired = {k for pair in found for k in pair}
        if len(paired) < _PAIRED * patterns.count or len(found) < 4:
            return None
        # Black and white are a pair that tells nothing more.
        plain = [pair for pair in found if _plain(patterns, pair[0])]
        others = [k for k in range(patterns.count) if k not in paired]
        others += [k for pair in plain for k in pair]
        return cls(tuple(pair for pair in found if pair not in plain), tuple(others))


def _plain(patterns: PatternSet, frame: int) -> bool:
    return float(np.ptp(patterns.rows(frame, frame + 1))) < 0.02


@dataclass(frozen=True, eq=False)
class PairSums:
    """Sums of the two samples of each pair.

    Parameters
    ----------
    pairs : Pairs
    samples : Samples
        Of m lively rows, (m, K).
    """

    pairs: Pairs
    samples: Samples

    def sum_of(self, j: int, k: int) -> NDArray[np.float64]:
        """Of two frames, (m,); NaN where one is clipped."""
        clipped = self.samples.clipped[:, j] | self.samples.clipped[:, k]
        both = self.samples.values[:, j].astype(np.float64) + self.samples.values[:, k]
        return np.where(clipped, np.nan, both)

    @cached_property
    def usual(self) -> NDArray[np.float64]:
        """What pairs add up to, (m,)."""
        return np.asarray(np.nanmedian(np.stack([self.sum_of(j, k) for j, k in self.pairs.of]), 0))

    def oddness(self, j: int, k: int) -> float:
        """How far two frames are from adding up to white, as a share of it."""
        relative = (self.sum_of(j, k) - self.usual) / np.maximum(self.usual, 1e-6)
        return float(np.sqrt(np.nanmean(np.clip(relative, -1, 1) ** 2)))

    @cached_property
    def odd(self) -> list[tuple[int, int]]:
        """The pairs that do not add up to white."""
        found = np.array([self.oddness(j, k) for j, k in self.pairs.of])
        limit = max(_ODD, _UNUSUAL * float(np.median(found)))
        return [pair for pair, size in zip(self.pairs.of, found, strict=True) if size > limit]

    def gain(self, frame: int, partner: int) -> float:
        """How much brighter a frame is than its partner says, where it is lit."""
        expected = self.usual - self.samples.values[:, partner]
        lit = (expected > 0.6 * self.usual) & ~self.samples.clipped[:, frame]
        if lit.sum() < 20:
            return 0.0
        return float(np.median(self.samples.values[lit, frame] / expected[lit])) - 1


def check_pairs(
    survey: Survey, rows: NDArray[np.int64], pairs: Pairs, names: Sequence[str]
) -> tuple[list[Finding], Survey, NDArray[np.bool_]]:
    """Order, single frames and motion, told from the sums of pairs.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Lively rows.
    pairs : Pairs
    names : sequence of str
        What the frames are called.

    Returns
    -------
    findings : list of Finding
    survey : Survey
        With swapped frames set right.
    doubted : (K,) bool
        Frames that are wrong in themselves.
    """
    doubted = np.zeros(survey.count, bool)
    moved = _check_motion(survey, pairs, names)
    if moved:
        return moved, survey, doubted
    sums = PairSums(pairs, survey.samples(rows))
    found: list[Finding] = []
    odd = list(sums.odd)
    if len(odd) > len(pairs.of) // 2:
        return [], survey, doubted
    for pair in list(odd):
        frame = _black_of(sums, pair)
        if frame is not None:
            odd.remove(pair)
            doubted[list(pair)] = True
            found.append(_say_black(frame, names))
    exchange = _exchange(survey, rows, sums, odd)
    if exchange is not None:
        survey = _exchanged(survey, exchange)
        odd = PairSums(pairs, survey.samples(rows)).odd
        a, b = sorted(exchange)
        found.append(
            Finding(
                "order",
                (a, b),
                f"{names[a]} and {names[b]} look swapped",
                "give each its own name, or put the images in the order of the patterns",
            )
        )
    for pair in odd:
        if doubted[list(pair)].all():
            continue
        doubted[list(pair)] = True
        found.append(
            Finding(
                "frame",
                pair,
                f"{names[pair[0]]} and {names[pair[1]]}, of a pattern and its inverse, do not add "
                "up to white: one shows something else",
                "look at them: taken during the change of pattern, moved, covered, in another's "
                "place? Take them again",
            )
        )
    return found, survey, doubted


def pair_gains(
    survey: Survey, rows: NDArray[np.int64], pairs: Pairs, doubted: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """How much brighter each frame is than its partner says, and which frames these are."""
    sums = PairSums(pairs, survey.samples(rows))
    frames = [(j, k) for pair in pairs.of for j, k in (pair, pair[::-1]) if not doubted[j]]
    return (
        np.array([sums.gain(j, k) for j, k in frames]),
        np.array([j for j, _ in frames], np.int64),
    )


def _black_of(sums: PairSums, pair: tuple[int, int]) -> int | None:
    """The frame of a pair that is dark where its partner is dark too."""
    for frame, partner in (pair, pair[::-1]):
        expected = np.nansum(np.maximum(sums.usual - sums.samples.values[:, partner], 0))
        light = float(np.nansum(sums.samples.values[:, frame]))
        other = float(np.nansum(sums.samples.values[:, partner]))
        if light < _BLACK * float(expected) + 0.05 * other and light < 0.3 * other:
            return frame
    return None


def _say_black(frame: int, names: Sequence[str]) -> Finding:
    return Finding(
        "frame",
        (frame,),
        f"{names[frame]}: black, although the pattern is not",
        "take the photograph again; the projector may have been blank or the shutter shut",
    )


def _exchange(
    survey: Survey, rows: NDArray[np.int64], sums: PairSums, odd: list[tuple[int, int]]
) -> tuple[int, int] | None:
    """The two frames that, exchanged, make all pairs add up to white."""
    usual = float(np.median([sums.oddness(j, k) for j, k in sums.pairs.of]))

    def right(order: dict[int, int]) -> bool:
        found = [sums.oddness(order.get(j, j), order.get(k, k)) for j, k in odd]
        return max(found) < max(_ODD, _UNUSUAL * usual)

    fitting = [(a, b) for a, b in _candidates(odd, sums.pairs.others) if right({a: b, b: a})]
    if len(fitting) < 2:
        return fitting[0] if fitting else None
    return min(fitting, key=lambda swap: jumps(_exchanged(survey, swap), rows))


def _candidates(odd: list[tuple[int, int]], others: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    if len(odd) == 2:
        yield from itertools.product(*odd)
    if len(odd) == 1:
        yield from itertools.product(odd[0], others)


def _exchanged(survey: Survey, swap: tuple[int, int]) -> Survey:
    order = np.arange(survey.count)
    order[list(swap)] = swap[::-1]
    return replace(survey, raw=survey.raw[:, order], decoder=survey.decoder.select(order))


def jumps(survey: Survey, rows: NDArray[np.int64]) -> float:
    """Mean logarithm of how many projector pixels apart neighbouring rows see; more if jumbled."""
    some = rows[:: max(1, len(rows) // _FEW_ROWS)]
    asked = [some, survey.neighbour(some, (0, MARGIN)), survey.neighbour(some, (MARGIN, 0))]
    samples = survey.samples(np.concatenate(asked))
    places = find_places(survey.patterns, samples, most=1)[0]
    here, *there = np.split(np.stack(np.divmod(places, survey.patterns.shape[1])), 3, axis=1)
    apart = [np.abs(here - other).max(axis=0) for other in there]
    return float(np.log1p(np.concatenate(apart)).mean())


def _check_motion(survey: Survey, pairs: Pairs, names: Sequence[str]) -> list[Finding]:
    """Whether the sums of pairs lie elsewhere from some pair on."""
    ordered = sorted(pairs.of, key=min)
    images = []
    for j, k in ordered:
        both = np.empty(len(survey.raw), np.float32)
        for part, tile in survey.some_frames(np.array([j, k])):
            both[part] = tile.values.sum(axis=1)
        images.append(both)
    shift = agreed_shift(survey, np.median(images[:3], axis=0), np.median(images[-3:], axis=0))
    if shift is None:
        return []
    moved = [agreed_shift(survey, images[0], image) is not None for image in images]
    first = next((k for k in range(len(moved)) if all(moved[k:])), None)
    if first is None:
        return []
    start = min(ordered[first])
    if any(moved[:first]):
        start = min(ordered[moved.index(True)])
    return [
        Finding(
            "motion",
            tuple(range(start, survey.count)),
            f"from {names[start]} on, or the frame before or after, the image lies "
            f"{describe_shift(shift)}",
            "fix camera, projector and scene, and take the capture again; or use the frames before "
            "or after it alone",
        )
    ]


def missing_of_pairs(survey: Survey, pairs: Pairs, rows: NDArray[np.int64]) -> tuple[int, ...]:
    """Which pattern has no frame, where the frames are one fewer and most patterns have inverses.

    A pattern and its inverse may be told apart by nothing; then both are named.

    Parameters
    ----------
    survey : Survey
        Its patterns number one more than its frames.
    pairs : Pairs
        Of all patterns.
    rows : (m,) int
        Lively rows.
    """
    count = survey.patterns.count
    samples = survey.samples(rows)
    oddness = []
    for place in range(count):
        frame = np.arange(count) - (np.arange(count) > place)
        known = tuple((int(frame[j]), int(frame[k])) for j, k in pairs.of if place not in (j, k))
        sums = PairSums(Pairs(known, ()), samples)
        oddness.append(float(np.mean([sums.oddness(j, k) for j, k in known])))
    best = min(oddness)
    likely = [place for place, size in enumerate(oddness) if size < 1.5 * best]
    if best > _ODD or len(likely) > 4:
        return ()
    apart = [
        jumps(
            replace(survey, patterns=survey.patterns.subset(np.delete(np.arange(count), k))), rows
        )
        for k in likely
    ]
    return tuple(
        place for place, size in zip(likely, apart, strict=True) if size < min(apart) + _JUMBLED
    )
