"""Whether the photographs follow the patterns at all, and if not, what would explain them.

Two photographs are alike as far as their patterns are: the cosines between the frames follow the
cosines between the patterns, seen through whatever blur and in whatever part of the projector. This
needs no prediction, so it judges captures that predict nothing because their frames belong to other
patterns. Only a permutation of whole frames, a change of some of their rows, or a change of sign
can then explain them; a camera that is turned as a whole is another relabelling of T.

The cosines of negatives are those of the photographs. Their signs show in the products of three
frames at the same pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.frame_cosines import (
    MOST_FRAMES,
    MOST_PRODUCTS,
    MOST_VALUES,
    Floats,
    binned_shape,
    cosines_of,
    counted_rows,
    gram_matrix,
    normalised,
    pattern_cosines,
    pattern_images,
    standardised_frames,
)
from lightmatrix.diagnosis.light_levels import one_level
from lightmatrix.diagnosis.pattern_faults import is_separable
from lightmatrix.diagnosis.survey import Survey

# Photographs follow their patterns if the correlation of the cosines exceeds that of shuffled
# frames by 3.5 of its standard deviations, over 60 shuffles. Another explanation must exceed it by
# 6, and by 4 more than the frames as they are. Chosen on the captures of
# `benchmarks/synthetic_captures.py`; tests/diagnosis/test_relation.py holds 161 intact ones.
_FOLLOWS, _EXPLAINS, _BETTER = 3.5, 6.0, 4.0
_SHUFFLES = 60
# Fewer frames than these are not judged.
_FEWEST_FRAMES = 16
# Triples of frames by whose products the sign is judged.
_TRIPLES = 4000
# Shuffles of these products cost more, so there are fewer.
_SIGN_SHUFFLES = 12
# Noise must not hide what the photographs show. So two halves of the camera pixels must agree about
# the frames by at least this correlation of their cosines. If all camera pixels see other projector
# pixels, they cannot; then the range of the usual one must be half of its brightest sample, and 24
# raw levels: about twice the range that a noise of 2.5 levels has in 64 frames. Chosen by hand.
_AGREE = 0.3
_LIVELY, _LIVELY_LEVELS = 0.5, 24
# The correlation of intact photographs of sharp footprints is about the root of the share of the
# projector pixels that the camera pixels can see. Times the root of the number of pairs of frames
# it must reach 8, so that photographs which follow their patterns would exceed 3.5 clearly.
_CLEAR = 8.0
# Random patterns have cosines of about 1 / sqrt(pixels). Patterns whose cosines vary by less than
# 0.3 of that (Hadamard, single pixels) are never said to be unrelated.
_RANDOM = 0.3

_ADVICE = "put photographs and patterns in the same order, from one and the same series"
_TURN_BACK = "turn them back, or take them again without touching the camera"


def check_relation(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Whether the photographs follow the patterns, or what else they follow."""
    if survey.count < _FEWEST_FRAMES:
        return []
    relation = Relation.of(survey)
    if relation is None:
        return []
    explanation = relation.explanation(names)
    if explanation is not None:
        message, advice = explanation
        return [Finding("order", (), message, advice)]
    if not relation.unrelated:
        return []
    return [
        Finding(
            "unrelated",
            (),
            "the photographs do not follow the patterns: do they belong together? Neither another "
            "order (by name, shifted by one), nor negatives, nor turned or mirrored photographs, "
            "nor rows that come a frame late explain them",
            "check that patterns and photographs are of one series (same seed and size) and in "
            "the same order",
        )
    ]


@dataclass(frozen=True, eq=False)
class Relation:
    """Standardised photographs beside the cosines of their patterns.

    `images` are the first K frames, (rows, cols, channels, K), 0 at pixels that do not count, and
    `rows` the numbers of their rows;
    `features` the cosines of the patterns through several blurs and in several parts of the
    projector, (F, K, K); `shown` some pixels of the patterns at each blur, (F', K, n), centred.
    `lively` tells whether the usual camera pixel varies by far more than noise.
    """

    images: Floats
    rows: NDArray[np.int64]
    features: Floats
    shown: tuple[Floats, ...]
    whole: bool
    count: int
    pixels: int
    lively: bool

    @classmethod
    def of(cls, survey: Survey) -> Relation | None:
        """The relation of a survey; None if too little of it can be compared."""
        binned = binned_shape(survey.patterns)
        pixels = binned[0] * binned[1]
        count = min(survey.count, MOST_FRAMES, max(_FEWEST_FRAMES, MOST_VALUES // pixels))
        standardised = standardised_frames(survey, count)
        if standardised is None or is_separable(survey.patterns):
            return None
        patterns = pattern_images(survey.patterns, count, binned)
        features, shown = pattern_cosines(patterns)
        if not len(features):
            return None
        whole = survey.grid[0] == 1
        lively = _is_lively(survey)
        return cls(*standardised, features, shown, whole, survey.count, pixels, lively)

    @cached_property
    def frames(self) -> NDArray[np.int64]:
        return np.arange(self.images.shape[-1])

    @cached_property
    def cosines(self) -> Floats:
        """Sums of products of the standardised photographs, (K, K)."""
        return gram_matrix(self.images)

    def excess(self, gram: Floats, order: NDArray[np.int64] | None = None) -> float:
        """By how many standard deviations a Gram matrix follows the patterns better than chance.

        Frame k shows pattern `order[k]`, or none if that is out of range.
        """
        shown = self.frames if order is None else order
        known = np.flatnonzero((shown >= 0) & (shown < len(self.frames)))
        if len(known) < _FEWEST_FRAMES - 1:
            return 0.0
        mean, deviation = self._chance
        # Fewer pairs of frames correlate more by chance.
        more = len(self.frames) / len(known)
        return (self._match(gram, known, shown[known]) - mean * more) / (deviation * more)

    def _match(self, gram: Floats, known: NDArray[np.int64], shown: NDArray[np.int64]) -> float:
        """The best correlation of the cosines of some frames with those of the patterns."""
        upper = np.triu_indices(len(known), 1)
        if len(known) == len(self.frames):
            # The frames change places and not the patterns, of which there are more cosines.
            known, features = np.argsort(shown), self._all_features
        else:
            features = normalised(self.features[:, shown[upper[0]], shown[upper[1]]])
        own = np.stack([each[upper] for each in cosines_of(gram[np.ix_(known, known)])])
        return float((features @ normalised(own).T).max())

    @cached_property
    def _all_features(self) -> NDArray[np.float64]:
        """The cosines of all pairs of patterns, of mean 0 and length 1, (F, pairs)."""
        upper = np.triu_indices(len(self.frames), 1)
        return normalised(self.features[:, upper[0], upper[1]])

    @cached_property
    def _chance(self) -> tuple[float, float]:
        """Mean and standard deviation of the matches of shuffled frames."""
        generator = np.random.default_rng(1)
        reached = [
            self._match(self.cosines, self.frames, generator.permutation(self.frames))
            for _ in range(_SHUFFLES)
        ]
        return float(np.mean(reached)), max(float(np.std(reached)), 1e-9)

    @cached_property
    def as_they_are(self) -> float:
        """The excess of the frames in their order."""
        return self.excess(self.cosines)

    @cached_property
    def _settled(self) -> float:
        """The same with each pixel's mean over some frames subtracted: something may have moved."""
        parts = np.array_split(self.frames, min(4, len(self.frames) // 8))
        return self.excess(_centred(self.cosines, parts))

    @property
    def unrelated(self) -> bool:
        """Whether nothing of the patterns is in the photographs, although it would show."""
        off = ~np.eye(len(self.frames), dtype=bool)
        random = self.features[0][off].std() > _RANDOM / np.sqrt(self.pixels)
        count = len(self.frames)
        rows = int(np.any(self.images != 0, axis=-1).sum())
        clear = rows / self.pixels * count * (count - 1) / 2 > _CLEAR**2
        follows = max(self.as_they_are, self._settled) > _FOLLOWS
        heard = self.lively or self._agreement > _AGREE
        return bool(clear and not follows and random and heard)

    @cached_property
    def _agreement(self) -> float:
        """Correlation of the cosines by one half of the camera pixels with those by the other."""
        rows = self.images.reshape(-1, len(self.frames))
        rows = rows[np.any(rows != 0, axis=1)]
        mixed = np.random.default_rng(1).permutation(len(rows))
        halves = [rows[part] for part in np.array_split(mixed, 2)]
        upper = np.triu_indices(len(self.frames), 1)
        first, second = (cosines_of(part.T @ part)[0][upper] for part in halves)
        return float(np.corrcoef(first, second)[0, 1])

    def explanation(self, names: Sequence[str]) -> tuple[str, str] | None:
        """What explains the photographs better than their order, and what to do."""
        late = self._late()
        if late is not None:
            return late
        found: list[tuple[float, tuple[str, str]]] = []
        for message, order in _orders(self.count):
            found.append((self.excess(self.cosines, order[: len(self.frames)]), (message, _ADVICE)))
        if self.whole:
            found += self._turned(names)
        score, explained = max(found, key=lambda each: each[0])
        if score > _EXPLAINS and score > self.as_they_are + _BETTER:
            return explained
        return self._negative()

    def _turned(self, names: Sequence[str]) -> Iterator[tuple[float, tuple[str, str]]]:
        """The excess with the later frames turned or mirrored back."""
        count = len(self.frames)
        flat = self.images.reshape(-1, count)
        products = {}
        for what, back in _TURNS.items():
            turned = back(self.images)
            if turned.shape == self.images.shape:
                products[what] = flat.T @ np.ascontiguousarray(turned).reshape(-1, count)
        for start in (count // 2, count // 4, 3 * count // 4):
            late = self.frames >= start
            # A pixel sees another surface from there on, of another brightness.
            parts = [self.frames[late], self.frames[~late]]
            own = _centred(self.cosines, parts)
            # Within its halves, the capture follows the patterns however these are turned.
            least = self.excess(own)
            for what, product in products.items():
                across = _centred(product, parts)
                mixed = np.where(late[None, :], across, across.T)
                mixed = np.where(late[:, None] == late[None, :], own, mixed)
                score = self.excess(mixed)
                if score > least + _BETTER:
                    message = f"from about {names[start]} on, the photographs are {what}"
                    yield score, (message, _TURN_BACK)

    def _late(self) -> tuple[str, str] | None:
        """Rows of the camera that show another pattern than the rest of the frame."""
        if not self.whole:
            return None
        upper = self.rows < self.rows.mean()
        odd = self.rows % 2 == 1
        bands = {
            "every other row of the photographs": [self.images[~odd], self.images[odd]],
            "one half of each photograph": [self.images[upper], self.images[~upper]],
        }
        for what, parts in bands.items():
            grams = [gram_matrix(part) for part in parts]
            own = [self.excess(gram) for gram in grams]
            for here, there in ((0, 1), (1, 0)):
                if own[there] < _EXPLAINS or own[here] > own[there] - _BETTER:
                    continue
                for step, when in ((-1, "late"), (1, "early")):
                    score = self.excess(grams[here], self.frames + step)
                    if score > _EXPLAINS and score > own[here] + _BETTER:
                        return (
                            f"{what} comes a frame {when}",
                            "wait longer between showing a pattern and taking its photograph, and "
                            "use a global shutter or the trigger of the projector",
                        )
        return None

    def _negative(self) -> tuple[str, str] | None:
        """Whether the photographs are negatives, or the patterns inverted."""
        rows = self.images.reshape(-1, len(self.frames))
        rows = rows[np.any(rows != 0, axis=1)][:MOST_PRODUCTS]
        triples = _triples(len(self.frames))
        own = _products(rows, triples)
        generator = np.random.default_rng(0)
        shuffles = [generator.permutation(len(self.frames)) for _ in range(_SIGN_SHUFFLES)]
        worst, best = 0.0, 0.0
        for shown in self.shown:
            matched = _correlation(own, _products(shown, triples))
            # Products of triples that share frames are nearly independent.
            score = matched * np.sqrt(len(triples))
            if score < -_FOLLOWS:
                reached = [
                    _correlation(own, _products(shown[:, order], triples)) for order in shuffles
                ]
                score = (matched - float(np.mean(reached))) / max(float(np.std(reached)), 1e-9)
            worst, best = min(worst, score), max(best, score)
            if best > _FOLLOWS:
                return None
        if worst > -_EXPLAINS:
            return None
        return (
            "the photographs are dark where their patterns are bright: one is a negative",
            "invert the patterns, or the photographs",
        )


def _centred(products: Floats, parts: Sequence[NDArray[np.int64]]) -> Floats:
    """Products of frames (K, K) as they are if each pixel's mean over each part is subtracted."""
    centre = np.eye(len(products), dtype=np.float32)
    for part in parts:
        centre[np.ix_(part, part)] -= 1 / len(part)
    return np.asarray(centre @ products @ centre, np.float32)


def _is_lively(survey: Survey) -> bool:
    """Whether the usual camera pixel that counts varies by far more than noise."""
    known, counted = survey.statistics, counted_rows(survey)
    span = known.highest[counted] - known.lowest[counted]
    least = np.maximum(_LIVELY * known.highest[counted], _LIVELY_LEVELS * one_level(survey))
    return bool(np.median(span - least) > 0)


_TURNS: dict[str, Callable[[Floats], Floats]] = {
    "turned by 180 degrees": lambda images: images[::-1, ::-1],
    "mirrored left to right": lambda images: images[:, ::-1],
    "mirrored top to bottom": lambda images: images[::-1],
    "turned by 90 degrees": lambda images: np.rot90(images),
    "turned by 270 degrees": lambda images: np.rot90(images, -1),
    "transposed": lambda images: images.swapaxes(0, 1),
}


def _orders(count: int) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Orders that frames come in by mistake: which pattern each of K frames shows."""
    frames = np.arange(count)
    for first in (0, 1):
        by_name = np.array(sorted(range(count), key=lambda k: str(k + first)))
        message = (
            f"the photographs are in the order of their names as text ({first}, "
            f"{'10, 11' if first else '1, 10'}, ...), and the patterns by their numbers"
        )
        yield message, by_name
        yield (
            message.replace("photographs", "patterns", 1).replace(
                "and the patterns by", "and the photographs by"
            ),
            np.argsort(by_name),
        )
    yield "each photograph shows the pattern after its own", frames + 1
    yield "each photograph shows the pattern before its own", frames - 1
    yield "the photographs follow the patterns backwards", frames[::-1].copy()


def _triples(count: int) -> NDArray[np.int64]:
    """Triples of different frames, (n, 3)."""
    drawn = np.random.default_rng(2).integers(0, count, (3 * _TRIPLES, 3))
    drawn.sort(axis=1)
    drawn = np.unique(drawn, axis=0)
    different = (drawn[:, 0] < drawn[:, 1]) & (drawn[:, 1] < drawn[:, 2])
    return np.random.default_rng(3).permutation(drawn[different])[:_TRIPLES]


def _products(rows: Floats, triples: NDArray[np.int64]) -> NDArray[np.float64]:
    """Sums over the rows of the products of three frames, (n,)."""
    frames = np.ascontiguousarray(rows.T)
    parts = np.array_split(triples, max(1, len(triples) * len(rows) >> 20))
    products = [(frames[a] * frames[b] * frames[c]).sum(axis=1) for a, b, c in (p.T for p in parts)]
    return np.concatenate(products).astype(np.float64)


def _correlation(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(normalised(one) @ normalised(other))
