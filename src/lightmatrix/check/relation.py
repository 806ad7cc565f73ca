"""Whether the photographs follow the patterns at all, and if not, what would explain them.

Two photographs are alike as far as their patterns are: the cosines between the frames follow the
cosines between the patterns, seen through whatever blur and in whatever part of the projector. This
needs no prediction, so it judges captures that predict nothing because their frames belong to other
patterns. A camera that is turned as a whole is another numbering of the rows of T. A frame that is
lost, or there twice, displaces all later ones; and a frame that shows the pattern of another one is
as like all others as that pattern is.

The cosines of negatives are those of the photographs. Their signs show in the correlations of
single camera pixels with pixels of the patterns.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.check.finding import WRONG_ORDER, Finding, order_findings
from lightmatrix.check.survey import Survey, bright_mean
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import is_separable

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Limits:
    """What is compared, and from where on photographs follow nothing.

    Chosen on the captures of `benchmarks/synthetic_captures.py`; tests/check/test_relation.py
    holds 161 intact ones.
    """

    # Fewer frames and camera pixels than these are not judged. Camera pixels count if their
    # standard deviation exceeds this share of that of the most varied tenth.
    frames: int = 16
    rows: int = 40
    # Frames of several exposures are standardised by themselves if there are more of each exposure
    # on average, and the capture is not judged if there are fewer: 16 intact frames of `metal`
    # under three exposures, of much noise, follow no better than chance.
    of_each: int = 8
    varied: float = 0.3
    # The work is bounded: a projector is binned to at most 2^16 pixels, and at most 2^23 values of
    # patterns and 2^22 samples of at most 256 frames are compared at a time. Correlations, which
    # tell negatives, are those between at most 1024 pixels of camera and projector.
    most_pixels: int = 1 << 16
    most_values: int = 1 << 23
    most_samples: int = 1 << 22
    most_frames: int = 256
    # Standard deviations of the blurs in projector pixels, and at each of them how many cells lie
    # along a side of the projector, to which a crop or a distant object may be confined. Up to
    # `few` frames tell less, and are compared in more cells, which overlap by half: photographs of
    # intact captures whose camera sees a part of the projector follow by 5.5 and more under 16
    # patterns then, else by 2.3 and more.
    blurs: tuple[float, ...] = (0, 1, 2, 4, 8)
    cells: tuple[tuple[int, ...], ...] = ((2, 4), (), (2,), (), ())
    few: int = 32
    cells_of_few: tuple[tuple[int, ...], ...] = ((2, 4), (2, 4), (2, 4), (2,), ())
    # Photographs follow their patterns if the correlation of the cosines exceeds that of shuffled
    # frames by this many of its standard deviations. Another explanation must exceed it by
    # `explains`, and by `better` more than the frames as they are.
    follows: float = 3.5
    explains: float = 6.0
    better: float = 4.0
    # Noise must not hide what the photographs show: two halves of the camera pixels must agree
    # about the frames by at least this correlation of their cosines. If all camera pixels see other
    # projector pixels, they cannot; then the range of the usual one must be half of its brightest
    # sample, and 24 raw levels, twice the range that a noise of 2.5 levels has in 64 frames.
    agree: float = 0.3
    contrast: float = 0.5
    contrast_levels: int = 24
    # The correlation of intact photographs of sharp footprints is about the root of the share of
    # the projector pixels that the camera pixels can see. Times the root of the number of pairs of
    # frames it must reach this, so that photographs which follow would exceed `follows` clearly.
    clear: float = 8.0
    # Random patterns have cosines of about 1 / sqrt(pixels). Patterns whose cosines vary by less
    # than this share of that (Hadamard, single pixels) are never said to be unrelated or exchanged.
    random: float = 0.3


_LIMITS = _Limits()


def check_relation(survey: Survey, name: Callable[[int], str] = str) -> list[Finding]:
    """Whether the photographs follow the patterns, or what else they follow.

    Messages call frame k `name(k)`.
    """
    few = survey.count < _LIMITS.frames or is_separable(survey.patterns)
    relation = None if few else Relation.of(survey)
    if relation is None:
        return []
    tried = [
        (relation.excess(order[: len(relation.frames)]), message)
        for message, order in likely_orders(survey.count)
    ]
    # The counter of a camera starts again after DSC_9999.
    for k in range(2, survey.count - 1):
        order = np.roll(np.arange(survey.count), -k)[: len(relation.frames)]
        message = f"the photographs begin with that of pattern {k}: did their numbers start again?"
        tried.append((relation.excess(order), message))
    score, message = max(tried)
    count, size = survey.count, len(relation.frames)
    later = [Relation.of(survey, min(k, count - size)) for k in range(size, count, size)]
    parts = [relation, *filter(None, later)]
    for part in parts:
        excess, place, step = part.displaced()
        if excess > max(_LIMITS.explains, part.as_they_are + _LIMITS.better, score):
            which = f"each photograph shows the pattern {'after' if step > 0 else 'before'} its own"
            lost = f"is one {'missing' if step > 0 else 'extra'}?"
            message = f"from {name(place)} to {name(count - 1)}, {which}: {lost}"
            return [Finding("order", tuple(range(place, count)), message, WRONG_ORDER)]
    if score > max(_LIMITS.explains, relation.as_they_are + _LIMITS.better):
        advice = "put photographs and patterns in the same order, from one series"
        return [Finding("order", (), message, advice)]
    if relation.negative:
        message = "the photographs are dark where their patterns are bright: one is a negative"
        return [Finding("order", (), message, "invert the patterns, or the photographs")]
    if relation.parted:
        message = (
            "the photographs of the first half and those of the second each follow their patterns, "
            "but do not fit together: was something turned or moved in between?"
        )
        late = tuple(range(survey.count // 2, survey.count))
        advice = "turn them back (EXIF orientation is not followed), or take the capture again"
        return [Finding("motion", late, message, advice)]
    if not relation.unrelated:
        return order_findings({k: j for part in parts for k, j in part.exchanged.items()}, name)
    message = (
        "the photographs do not follow the patterns: do they belong together? Neither another "
        "order (by name, shifted, backwards) nor negatives explain them"
    )
    advice = (
        "check that patterns and photographs are of one series (same seed and size) and in the "
        "same order, and that nothing was turned or moved in between"
    )
    return [Finding("unrelated", (), message, advice)]


def check_unseen(survey: Survey) -> tuple[list[Finding], Survey]:
    """Whether hardly any camera pixel sees the projector; and the survey of those that do."""
    known, valid = survey.statistics, survey.valid
    span = np.where(valid, known.highest - known.lowest, 0)
    # Pixels that vary by less than 3 raw levels, or by less than 5 % of the others, may not see it.
    # One that always clips does not vary either, but sees too much.
    least = max(0.05 * bright_mean(span), 3 * survey.one_level)
    still = valid & (span < least) & (known.clipped < 0.5)
    unseen = float(still.sum()) / max(int(valid.sum()), 1)
    if unseen < 0.9:
        return [], survey
    # A dark ground around bright dots follows the patterns, noise does not. The dimmer half is
    # judged, without the rim of what the projector lights.
    dim = still & (known.spread <= np.median(known.spread[still]))
    relation = Relation.of(replace(survey, valid=dim))
    if relation is not None and (
        relation.as_they_are > _LIMITS.follows or relation._agreement > _LIMITS.agree
    ):
        return [], survey
    message = f"{100 * unseen:.0f} % of the camera pixels never see light of the projector"
    advice = "move camera or lens so that the lit part fills the image, or mask the rest"
    return [Finding("unseen", (), message, advice)], replace(survey, valid=valid & ~still)


@dataclass(frozen=True, eq=False)
class Relation:
    """Standardised photographs beside the cosines of their patterns.

    `samples` are those of K frames from `first` on, of mean 0 and variance 1 in each camera pixel,
    (m, K); `rest` is what is left of them without what all camera pixels share. `features` are the
    cosines of the patterns through several blurs and in several parts of the projector, (F, K, K);
    `shown` some pixels of the patterns at each blur, (F', n, K), standardised. `patterns` are all,
    and `pixels` is the number of the projector's pixels once binned. `contrasted` tells whether the
    usual camera pixel varies by far more than noise, and `overlap` how much of the light of either
    half of the frames the other one has, too. `enough` tells whether enough of the frames do not
    clip in most camera pixels.
    """

    patterns: PatternSet
    samples: Floats
    rest: Floats
    features: Floats
    shown: tuple[Floats, ...]
    pixels: int
    contrasted: bool
    overlap: float
    enough: bool
    # The frames of each exposure, which are standardised by themselves; or none.
    groups: list[NDArray[np.int64]]
    first: int = 0

    @classmethod
    def of(cls, survey: Survey, first: int = 0) -> "Relation | None":
        """The relation of a survey; None if too little of it can be compared."""
        step = 1
        while np.prod([max(1, n // step) for n in survey.patterns.shape]) > _LIMITS.most_pixels:
            step *= 2
        pixels = int(np.prod([max(1, n // step) for n in survey.patterns.shape]))
        most = max(_LIMITS.frames, _LIMITS.most_values // pixels)
        count = min(survey.count - first, _LIMITS.most_frames, most)
        frames = slice(first, first + count)
        known = survey.statistics
        usable = survey.valid & (known.spread > 0)
        if usable.any():
            usable &= known.spread > _LIMITS.varied * np.quantile(known.spread[usable], 0.9)
        rows = np.flatnonzero(usable)
        if len(rows) < _LIMITS.rows:
            return None
        span = known.highest[rows] - known.lowest[rows]
        least = _LIMITS.contrast_levels * survey.one_level
        least = np.maximum(_LIMITS.contrast * known.highest[rows], least)
        rows = np.sort(np.random.default_rng(0).permutation(rows)[: _LIMITS.most_samples // count])
        taken = survey.samples(rows)
        values = taken.values[:, frames].copy()
        images = _binned(survey.patterns, frames, step)
        # Under a curve that is not declared, frames differ most by their exposure. The frames of
        # each exposure, to a factor of two, are therefore standardised by themselves first.
        exposures = np.broadcast_to(survey.decoder.exposure, survey.count)[frames]
        levels, of_frame = np.unique(np.rint(np.log2(exposures)), return_inverse=True)
        many = len(levels) == 1 or count > _LIMITS.of_each * len(levels)
        groups = [np.flatnonzero(of_frame == k) for k in range(len(levels)) if many]
        # A displaced frame may have another exposure than that of its place.
        if len(levels) > 1:
            values /= np.maximum(values.mean(axis=0), 1e-6)
            images /= np.maximum(images.mean(axis=(1, 2), keepdims=True), 1e-6)
        for group in groups:
            values[:, group] = _standardised(values[:, group])
        samples = _standardised(values)
        halves = [part.mean(axis=0) for part in np.array_split(images, 2)]
        overlap = float(np.minimum(*halves).sum() / max(float(np.maximum(*halves).sum()), 1e-9))
        features, shown = _pattern_cosines(images)
        rest = _without_shared(samples, survey, rows)
        if step > 1:
            # Camera pixels that see single projector pixels follow little of what bins show.
            features = np.concatenate([features, _sharp_cosines(survey.patterns, frames)])
        contrasted = bool(np.median(span - least) > 0)
        telling = int((taken.clipped[:, frames].mean(axis=0) < 0.5).sum())
        enough = telling >= max(_LIMITS.frames, _LIMITS.of_each * len(levels))
        made = (samples, rest, features, shown, pixels, contrasted, overlap, enough, groups, first)
        return cls(survey.patterns, *made)

    @cached_property
    def frames(self) -> NDArray[np.int64]:
        return np.arange(self.samples.shape[-1])

    @cached_property
    def cosines(self) -> Floats:
        """Cosines between the photographs as they are and their `rest`, (2, K, K)."""
        sums = np.stack([each.T @ each for each in (self.samples, self.rest)])
        for group in self.groups:
            # Samples that sum to 0 over a few frames make these unlike each other, far more so than
            # random patterns differ.
            block, others = np.ix_(group, group), ~np.eye(len(group), dtype=bool)
            for each in sums if len(group) > 1 else ():
                each[block] -= others * each[block][others].mean()
        return _cosines_of(sums)

    def excess(self, order: NDArray[np.int64]) -> float:
        """By how many standard deviations frames follow the patterns better than chance.

        Frame k shows pattern `order[k]`, or none if that is out of range.
        """
        frames = frames_of(order)
        shown = np.flatnonzero(frames >= 0)
        known = frames[shown]
        if len(known) < _LIMITS.frames - 1:
            return 0.0
        mean, deviation = self._chance
        # Fewer pairs of frames correlate more by chance.
        more = len(self.frames) / len(known)
        matches = self._matches(known, shown).max(axis=0)
        return float(((matches - mean * more) / (deviation * more)).max())

    def _matches(self, known: NDArray[np.int64], shown: NDArray[np.int64]) -> Floats:
        """The correlations of the cosines of some frames with those of the patterns, (F, 2)."""
        own, theirs, squares = self._limited
        placed = np.zeros((3, *own.shape[1:]), np.float32)
        placed[:2, shown[:, None], shown] = own[:, known[:, None], known]
        placed[2, shown[:, None], shown] = 1
        np.fill_diagonal(placed[2], 0)
        frames, weight = placed[:2].reshape(2, -1), placed[2].ravel() / placed[2].sum()
        spread = np.sqrt(np.maximum(frames**2 @ weight - (frames @ weight) ** 2, 0))
        mean = theirs @ weight
        products = theirs @ (frames * weight).T - np.outer(mean, frames @ weight)
        lengths = np.outer(np.sqrt(np.maximum(squares @ weight - mean**2, 0)), spread)
        # Cosines that hardly differ, of which rounding is left, match nothing.
        return np.asarray(np.where(lengths > 1e-7, products / np.maximum(lengths, 1e-7), 0))

    @cached_property
    def _limited(self) -> tuple[Floats, Floats, Floats]:
        """The cosines of the frames, (2, K, K), those of the patterns, (F, K * K), and squared.

        They are differences from the mean of all pairs. None counts too much, a frame's own is 0.
        """
        off = ~np.eye(len(self.frames), dtype=bool)
        own, theirs = self.cosines.copy(), self.features.copy()
        # A bit of the picture before makes each photograph as much more like the one before it.
        beside = np.abs(self.frames[:, None] - self.frames) == 1
        own[:, beside] -= (own[:, beside].mean(axis=1) - own[:, off].mean(axis=1))[:, None]
        for each in (own, theirs):
            pairs = each[:, off].clip(*_limits(each[:, off]))
            each[:] = 0
            each[:, off] = pairs - pairs.mean(axis=1, keepdims=True)
        theirs = theirs.reshape(len(theirs), -1)
        return own, theirs, theirs**2

    @cached_property
    def _chance(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Means and standard deviations, (2,), of the matches of frames in 60 random orders."""
        generator = np.random.default_rng(1)
        shuffled = [generator.permutation(self.frames) for _ in range(60)]
        reached = [self._matches(self.frames, order).max(axis=0) for order in shuffled]
        return np.mean(reached, axis=0), np.maximum(np.std(reached, axis=0), 1e-9)

    @cached_property
    def as_they_are(self) -> float:
        """The excess of the frames in their order."""
        return self.excess(self.frames)

    def displaced(self, shortest: int = 3) -> tuple[float, int, int]:
        """The frame from which on each shows the pattern after its own (1), or before it (-1).

        The likeliest one, between its excess and the step, if `shortest` frames follow it.
        """
        # Places are tried coarsely, then around the best.
        last, tried = len(self.frames) - shortest, list[tuple[float, int, int]]()
        for step in (1, -1):
            best, reach = 0, last
            for places in (17, 2 * -(-last // 16) + 1):
                near = np.linspace(max(0, best - reach), min(last, best + reach), places)
                orders = {int(k): self.frames + step * (self.frames >= int(k)) for k in near}
                found = [(self.excess(order), k, step) for k, order in orders.items()]
                best, reach = max(found)[1], -(-last // 16)
            tried += found
        excess, place, step = max(tried)
        return excess, self.first + place, step

    @cached_property
    def exchanged(self) -> dict[int, int]:
        """Which frames show the pattern of which other one, if the patterns are random."""
        exchanged: dict[int, int] = {}
        if not self.random:
            return exchanged
        matches = self._matches(self.frames, self.frames)
        feature, variant = np.unravel_index(int(matches.argmax()), matches.shape)
        off = ~np.eye(len(self.frames), dtype=bool)

        # Frame i and pattern j are compared by their cosines with all but i and j.
        own, shown = (
            np.where(off, each - np.median(each, axis=1, keepdims=True), 0)
            for each in (self.cosines[variant], self.features[feature])
        )
        squares = [(each**2).sum(axis=1, keepdims=True) - each**2 for each in (own, shown)]
        alike = (own @ shown.T) / np.sqrt(np.maximum(squares[0] * squares[1].T, 1e-12))
        # In standard deviations of what frames and patterns are that do not belong together.
        alike = np.arctanh(np.clip(alike, -0.999, 0.999))
        alike /= max(float(alike[off].std()), 1e-9)
        own, others = np.diag(alike), np.where(off, alike, -np.inf)
        best, (third, most) = others.argmax(axis=1), np.sort(others, axis=1)[:, -2:].T
        # Most frames must be more like their own patterns than like any other.
        if np.median(own) < np.median(most):
            return exchanged
        # On captures of the bundled scenes under 20 to 64 patterns, exchanged frames gained 3.7 to
        # 8, and their pattern led any third one by 2.2 to 6; others gained up to 2.1, and led by
        # up to 1.7. Two that show each other's pattern need less.
        gain = most - own
        for k in np.flatnonzero(gain > 0):
            j = int(best[k])
            both = best[j] == k and gain[j] > 0 and gain[k] + gain[j] > 5
            if both or (gain[k] > 3.5 and most[k] - third[k] > 2):
                exchanged[self.first + int(k)] = self.first + j
        return exchanged

    @property
    def random(self) -> bool:
        """Whether the cosines of the patterns differ as those of random ones do."""
        off = ~np.eye(len(self.frames), dtype=bool)
        return bool(self.features[0][off].std() > _LIMITS.random / np.sqrt(self.pixels))

    @property
    def unrelated(self) -> bool:
        """Whether nothing of the patterns is in the photographs, although it would show."""
        count = len(self.frames)
        pairs = count * (count - 1) / 2
        clear = len(self.samples) / self.patterns.pixels * pairs > _LIMITS.clear**2
        visible = self.contrasted or self._agreement > _LIMITS.agree
        judged = clear and self.enough and self.random and visible
        return bool(judged and self.as_they_are < _LIMITS.follows)

    @property
    def parted(self) -> bool:
        """Whether each half of the frames follows its patterns, but not beside the other half."""
        late = self.frames >= self.patterns.count // 2
        # At most 256 frames are compared: beyond 496 frames, too few lie in the later half. Halves
        # that light different places, such as single pixels row by row, have little in common.
        if late.sum() < 8 or self.overlap < 0.5 or not self.random:
            return False
        same = late[:, None] == late
        # A camera pixel that sees another place from there on has another brightness.
        centre = (np.eye(len(late)) - same / same.sum(axis=1)).astype(np.float32)
        upper = np.triu_indices(len(late), 1)
        own = _cosines_of(centre @ self.cosines @ centre)[:, *upper]
        # A pattern and itself again, or its inverse, tell more than all others.
        plain = np.abs(self.features[0][upper]) < 0.5
        if not plain.any():
            return False
        theirs = self._limited[1].reshape(self.features.shape)[:, *upper]
        within, across = (
            _normalised(theirs[:, part]) @ _normalised(own[:, part].clip(*_limits(own[:, part]))).T
            for part in (plain & same[upper], plain & ~same[upper])
        )
        # Pairs of different patterns are nearly independent.
        shown = len(np.unique((self.features[0] > 0.99).argmax(axis=1))) / len(late)
        certain = float(within.max()) * np.sqrt((plain & same[upper]).sum()) * shown
        # The quotient of the two was 0.54 to 1.23 on intact captures of
        # `benchmarks/synthetic_captures.py`, and up to 0.31 where half of them was turned (but 0.44
        # where broad light was mirrored).
        least = _LIMITS.explains + _LIMITS.better
        return bool(certain > least and across.flat[within.argmax()] < 0.4 * within.max())

    @cached_property
    def _agreement(self) -> float:
        """Correlation of the cosines by one half of the camera pixels with those by the other."""
        mixed = np.random.default_rng(1).permutation(len(self.samples))
        upper = np.triu_indices(len(self.frames), 1)
        halves = [self.samples[part] for part in np.array_split(mixed, 2)]
        first, second = (_cosines_of(part.T @ part)[upper] for part in halves)
        return float(_normalised(first) @ _normalised(second))

    @property
    def negative(self) -> bool:
        """Whether the photographs are negatives, or the patterns inverted."""
        generator, count = np.random.default_rng(0), len(self.frames)
        orders = [self.frames, *(generator.permutation(count) for _ in range(12))]
        worst = 0.0
        for shown in self.shown:
            # Camera pixels correlate with few pixels of the projector, and strongly: cubes keep
            # the sign of these.
            each = (self.samples[:1024, order] @ shown.T / count for order in orders)
            # Two products are twenty times as fast as NumPy's power.
            followed, *chance = (float((match * match * match).mean()) for match in each)
            score = (followed - float(np.mean(chance))) / max(float(np.std(chance)), 1e-12)
            if score > _LIMITS.follows:
                return False
            worst = min(worst, score)
        return worst < -_LIMITS.explains


def frames_of(shown: NDArray[np.int64]) -> NDArray[np.int64]:
    """The frame that shows each of K patterns, or -1; frame k shows pattern `shown[k]`, if any.

    The first of several frames that show a pattern counts.
    """
    frames = np.full(len(shown), -1)
    known = np.flatnonzero((shown >= 0) & (shown < len(shown)))[::-1]
    frames[shown[known]] = known
    return frames


def likely_orders(count: int) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Orders that frames come in by mistake: which pattern each of K frames shows."""
    frames = np.arange(count)
    for first in (0, 1):
        by_name = np.array(sorted(range(count), key=lambda k: str(k + first)))
        example = f"({first}, {'10, 11' if first else '1, 10'}, ...)"
        for one, other, order in (
            ("photographs", "patterns", by_name),
            ("patterns", "photographs", np.argsort(by_name)),
        ):
            yield (
                f"the {one} are in the order of their names as text {example}, and the {other} by "
                "their numbers",
                order,
            )
    yield "each photograph shows the pattern after its own", frames + 1
    yield "each photograph shows the pattern before its own", frames - 1
    yield "the photographs are in the opposite order of the patterns", frames[::-1]


def _binned(patterns: PatternSet, frames: slice, step: int) -> Floats:
    """Some patterns, with blocks of `step` x `step` pixels averaged, (K, rows, cols)."""
    down, right = (min(step, size) for size in patterns.shape)
    rows, cols = patterns.shape[0] // down, patterns.shape[1] // right
    images = np.empty((frames.stop - frames.start, rows, cols), np.float32)
    for k, shown in enumerate(images, frames.start):
        image = patterns.images(k, k + 1)[0][: rows * down, : cols * right]
        shown[:] = image.reshape(rows, down, cols, right).mean(axis=(1, 3))
    return images


def _pattern_cosines(patterns: Floats) -> tuple[Floats, tuple[Floats, ...]]:
    """Cosines between patterns through blurs and in cells, and the blurred patterns."""
    count, rows, cols = patterns.shape
    grams, shown = [], []
    few = count <= _LIMITS.few
    cells_of_blurs = _LIMITS.cells_of_few if few else _LIMITS.cells
    for blur, of_cells in zip(_LIMITS.blurs, cells_of_blurs, strict=True):
        if blur > min(rows, cols) / 4:
            continue
        seen = patterns
        if blur:
            # Products of matrices are quicker than filters.
            sides = (np.eye(n, dtype=np.float32) for n in (rows, cols))
            down, right = (scipy.ndimage.gaussian_filter1d(side, blur) for side in sides)
            seen = down @ patterns @ right.T
        seen = seen - seen.mean(axis=0)
        flat = seen.reshape(count, -1)
        grams.append(flat @ flat.T)
        # A camera pixel is standardised whatever it sees; so are these.
        some = np.random.default_rng(4).permutation(flat.shape[1])[:1024]
        shown.append((flat[:, some] / np.maximum(flat[:, some].std(axis=0), 1e-6)).T)
        if not of_cells:
            continue
        # Sums of products in the smallest parts are added up to those of every cell.
        parts = 2 * max(of_cells)
        small = np.empty((parts, parts, count, count), np.float32)
        for i, band in enumerate(np.array_split(seen, parts, axis=1)):
            for j, part in enumerate(np.array_split(band, parts, axis=2)):
                flat = part.reshape(count, -1)
                small[i, j] = flat @ flat.T
        for cells in of_cells:
            side = parts // cells
            step = side // 2 if few else side
            starts = range(0, parts - side + 1, step)
            grams += [
                small[i : i + side, j : j + side].sum(axis=(0, 1)) for i in starts for j in starts
            ]
    mean = patterns.mean(axis=(1, 2))
    mean = mean - mean.mean()
    grams.append(np.outer(mean, mean))
    cosines = _cosines_of(np.stack(grams))
    off = ~np.eye(count, dtype=bool)
    # Cosines that do not differ tell nothing; the first stays, which says whether they are random.
    varied = [i for i, each in enumerate(cosines) if i == 0 or each[off].std() > 1e-5]
    return cosines[varied], tuple(shown)


def _sharp_cosines(patterns: PatternSet, frames: slice) -> Floats:
    """Cosines between some patterns as they are, not binned, (1, K, K)."""
    gram = np.zeros((frames.stop - frames.start,) * 2, np.float32)
    for start in range(0, patterns.pixels, 1 << 16):
        shown = patterns.span(start, min(start + (1 << 16), patterns.pixels))[frames]
        seen = shown - shown.mean(axis=0)
        gram += seen @ seen.T
    return _cosines_of(gram)[None]


def _cosines_of(gram: Floats) -> Floats:
    """Cosines between frames by the sums of their products, (..., K, K)."""
    length = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-12))
    size = length[..., :, None] * length[..., None, :]
    # A frame that shows nothing has no cosine.
    return np.asarray(np.where(size > 1e-9, gram / size, 0))


def _without_shared(samples: Floats, survey: Survey, rows: NDArray[np.int64]) -> Floats:
    """Standardised samples (m, K) without what faults do to all camera pixels.

    Light and room light that vary, and a camera that moves, turns or zooms, add numbers of each
    frame times the mean photograph, a constant, and the mean's derivatives times the place.
    """
    mean = survey.statistics.mean.reshape(survey.grid)
    _, down, right, _ = np.ogrid[tuple(slice(-1, 1, n * 1j) for n in mean.shape)]
    slopes = [np.gradient(mean, axis=axis) for axis in (1, 2) if mean.shape[axis] > 1]
    terms = [each for s in slopes for each in (s, s * down, s * right)]
    shared = np.stack([each.ravel()[rows] for each in (np.ones_like(mean), mean, *terms)], axis=1)
    basis = np.linalg.qr(shared / survey.statistics.spread[rows, None])[0].astype(np.float32)
    return np.asarray(samples - basis @ (basis.T @ samples))


def _standardised(values: Floats) -> Floats:
    """Rows of mean 0 and variance 1; of zeros where nothing varies."""
    centred = values - values.mean(axis=1, keepdims=True)
    spread = centred.std(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(spread, 1e-12) * (spread > 0), np.float32)


def _normalised(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Vectors along the last axis, of mean 0 and length 1."""
    centred = values - values.mean(axis=-1, keepdims=True, dtype=np.float64)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return np.asarray(centred / np.maximum(length, 1e-9))


def _limits(pairs: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest cosine along the last axis between which no pair counts too much.

    Two photographs of one pattern, by mistake, are more alike than any others are.
    """
    middle = np.median(pairs, axis=-1, keepdims=True)
    usual = np.median(np.abs(pairs - middle), axis=-1, keepdims=True)
    most = 6 * np.maximum(usual, 0.1 * pairs.std(axis=-1, keepdims=True))
    return middle - most, middle + most
