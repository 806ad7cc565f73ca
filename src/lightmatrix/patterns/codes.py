"""Codes of stripes, and which projector pixel a camera pixel sees by its samples under them.

The code is read from the patterns themselves, in whatever order. Black and white codes are decoded
bit by bit, any other by the best correlation with the samples. Then the samples are explained as a
mixture of two neighbouring projector pixels, for the place within the pixel.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import COLUMNS, NOTHING, ROWS, Stripes, stripes_of

Singles = NDArray[np.float32]
Indices = NDArray[np.int64]

# Grey values that differ by less than one level of 8 bits are the same.
_LEVEL = 1 / 255
# A place that the samples leave open is looked for within this many lines. Chosen by hand: a camera
# that resolves 8 projector pixels leaves three bits open.
_OPEN = 16
# Where samples clip, places are tried in steps of this share of a line. Chosen by hand: half of it
# would take twice the time.
_FINE = 0.25


@dataclass(frozen=True, eq=False)
class Code:
    """The values that number the projector's pixels along one axis, COLUMNS or ROWS.

    Neighbouring pixels that all patterns show alike are one line: one pixel of most codes, a block
    of those that lack their finest bits.
    """

    axis: int
    # (k,): the patterns of the code; of a code without inverses, white and black too.
    frames: Indices
    # (lines, k): the value of each line in each of these patterns.
    values: Singles
    # The first pixel of each line, and the number of all pixels, (lines + 1,).
    starts: Indices
    # The patterns of each bit and of its inverse, as indices into `frames`; -1 where there is no
    # inverse. Empty if some value is grey.
    bits: tuple[tuple[int, int], ...]

    @cached_property
    def centred(self) -> Singles:
        """The values of each line less their mean, (lines, k): without the constant light."""
        return np.asarray(self.values - self.values.mean(axis=1, keepdims=True), np.float32)

    @cached_property
    def squares(self) -> NDArray[np.float64]:
        """Squared norm of each line's centred values, (lines,)."""
        # A constant word has no light, and divides nothing by 0.
        return np.maximum((self.centred.astype(np.float64) ** 2).sum(axis=1), 1e-12)

    @cached_property
    def words(self) -> Indices:
        """The line of each word of bits, (2^bits,); -1 where it does not occur."""
        lit = self.values[:, [frame for frame, _ in self.bits]] > 0.5
        lines = np.full(1 << len(self.bits), -1)
        lines[lit @ (1 << np.arange(len(self.bits)))] = np.arange(len(lit))
        return lines

    @property
    def changes(self) -> NDArray[np.float64]:
        """How often each pattern changes along the axis, (k,); fine stripes change most often."""
        return np.rint(np.abs(np.diff(self.values, axis=0)).sum(axis=0))

    @property
    def paired(self) -> bool:
        """Whether the values are bits with inverses."""
        return min((inverse for _, inverse in self.bits), default=-1) >= 0

    @property
    def block(self) -> int:
        """The projector pixels of a usual line."""
        return int(np.median(np.diff(self.starts)))

    def places(self, line: NDArray[np.floating]) -> NDArray[np.float64]:
        """The projector pixel in the middle of lines, to fractions."""
        middle = (self.starts[1:] + self.starts[:-1] - 1) / 2
        return np.interp(line, np.arange(len(middle)), middle)


@dataclass(frozen=True, eq=False)
class Codes:
    """The codes of a capture, and its uniform patterns: the brightest and the darkest, or None."""

    codes: tuple[Code, ...]
    white: int | None
    black: int | None

    def lines(self, code: Code, values: Singles, frames: Indices) -> Indices:
        """The line of a code of bits that m camera pixels see, -1 for none, (m,).

        `values` (K, m) are samples, `frames` (patterns,) the one that shows each pattern.
        """
        shown = frames[code.frames]
        own = values[shown[shown >= 0]]
        ends = [
            own.max(axis=0) if self.white is None else values[frames[self.white]],
            own.min(axis=0) if self.black is None else values[frames[self.black]],
        ]
        middle = (ends[0] + ends[1]) / 2
        word = np.zeros(values.shape[1], np.int64)
        for place, (frame, inverse) in enumerate(code.bits):
            # The brighter of a pattern and its inverse decides a bit; without inverse, whether the
            # sample is above the middle of black and white.
            threshold = middle if inverse < 0 else values[shown[inverse]]
            word |= (values[shown[frame]] > threshold).astype(np.int64) << place
        return code.words[word]


def find_codes(patterns: PatternSet) -> Codes:
    """The codes of the columns and of the rows.

    An InputError says that a pattern varies along both or is in colour, or that the patterns of an
    axis show two of its pixels alike that do not lie side by side.
    """
    if isinstance(patterns, ColourPatterns):
        raise InputError(
            "the patterns are in colour, and no code of stripes in colour is known",
            hint="save them as grey images, or estimate T from them with `estimate`",
        )
    stripes = stripes_of(patterns)
    if stripes is None:
        raise InputError(
            "these patterns are no stripes: one varies along both rows and columns",
            hint="estimate T from them with `estimate`",
        )
    uniform = np.flatnonzero(stripes.axes == NOTHING)
    white = next((int(k) for k in uniform if stripes.profiles[k][0] > 1 - _LEVEL), None)
    black = next((int(k) for k in uniform if stripes.profiles[k][0] < _LEVEL), None)
    ends = [(k, value) for k, value in ((white, 1), (black, 0)) if k is not None]
    found = tuple(
        _code(stripes, axis, ends) for axis in (COLUMNS, ROWS) if (stripes.axes == axis).any()
    )
    if not found:
        raise InputError("no pattern varies", hint="project a code, such as Gray code")
    return Codes(found, white, black)


def _code(stripes: Stripes, axis: int, ends: list[tuple[int, int]]) -> Code:
    """The code of an axis; `ends` are the white and the black pattern, as far as there are any."""
    frames = np.flatnonzero(stripes.axes == axis)
    values = np.stack([stripes.profiles[k] for k in frames], axis=1)
    levels = np.rint(values / _LEVEL)
    starts = np.flatnonzero(np.append(True, (levels[1:] != levels[:-1]).any(axis=1)))
    distinct = len(np.unique(levels, axis=0))
    if distinct < len(starts):
        lines = "columns" if axis == COLUMNS else "rows"
        raise InputError(
            f"the {len(frames)} patterns along {lines} tell only {distinct} of {len(values)} "
            f"{lines} apart, and some of them do not lie side by side",
            hint="is a pattern missing? project the whole code",
        )
    values, starts = values[starts], np.append(starts, len(values))
    bits = _bits(values)
    if any(inverse < 0 for _, inverse in bits):
        # Without inverses, the words of only 0 or only 1 are as constant as no light at all. White
        # and black tell them apart; where there are inverses, they would only add global light.
        frames = np.concatenate([frames, [k for k, _ in ends]]).astype(np.int64)
        constant = [np.full((len(values), 1), value, np.float32) for _, value in ends]
        values = np.concatenate([values, *constant], axis=1)
    return Code(axis, frames, values, starts, bits)


def _bits(values: Singles) -> tuple[tuple[int, int], ...]:
    """Each bit with its inverse, once; none if a value is neither black nor white."""
    lit = values > 0.5
    if (np.abs(values - lit) > _LEVEL).any():
        return ()
    known: dict[bytes, int] = {}
    pairs: list[list[int]] = []
    for k, bit in enumerate(lit.T):
        if bit.tobytes() in known:
            continue
        inverse = known.get((~bit).tobytes())
        if inverse is None:
            known[bit.tobytes()] = len(pairs)
            pairs.append([k, -1])
        elif pairs[inverse][1] < 0:
            pairs[inverse][1] = k
    return tuple((first, second) for first, second in pairs)


def best_code_pixels(patterns: PatternSet, samples: NDArray[np.floating]) -> Indices | None:
    """The projector pixels that m rows (m, K) follow best, (m,); None if the patterns are no code.

    Columns and rows are looked for by themselves, which takes a thousandth of the time that all
    pixels take.
    """
    try:
        codes = find_codes(patterns).codes
    except InputError:
        return None
    place = np.zeros((len(samples), 2), np.int64)
    for code in codes:
        own = np.ascontiguousarray(samples[:, code.frames], np.float32)
        place[:, code.axis] = np.rint(code.places(correlate(code, own)[0][0]))
    return place @ np.array([patterns.shape[1], 1])


@dataclass(frozen=True, eq=False)
class Reading:
    """What m camera pixels see along one axis."""

    # The projector pixel to fractions; NaN where the samples are no word of the code.
    place: NDArray[np.float64]
    # How much brighter a lit projector pixel makes the camera pixel than a dark one, in units of
    # the clip level.
    light: NDArray[np.float64]
    # Share of the samples' variance that the code explains, in [0, 1].
    explained: NDArray[np.float64]
    # Standard deviation of the place, in projector pixels.
    uncertainty: NDArray[np.float64]
    # Logarithm of how much likelier the place makes the samples than the best of all places makes
    # mere noise.
    evidence: NDArray[np.float64]


def correlate(code: Code, samples: Singles) -> tuple[Indices, NDArray[np.float64]]:
    """The line whose values correlate best with each camera pixel's samples (m, k), and a rival.

    The most likely one under noise that is the same in all samples, whatever the surface and the
    constant light (Mirdehghan et al. 2018). Places half way between two lines are tried too: few
    patterns of short periods resemble them elsewhere better than in their neighbours. The rival is
    the best of the lines that do not lie around the first one.

    Returns both lines, (2, m), and the share of the samples' variance that each explains. The rival
    of a line that explains more than 98 % is not looked for, and explains nothing.
    """
    centred = np.empty((2 * len(code.values) - 1, samples.shape[1]), np.float32)
    centred[::2] = code.centred
    centred[1::2] = (code.centred[1:] + code.centred[:-1]) / 2
    length = np.sqrt((centred**2).sum(axis=1, keepdims=True))
    directions = np.ascontiguousarray((centred / np.maximum(length, 1e-12)).T)
    line, share = np.zeros((2, len(samples)), np.int64), np.zeros((2, len(samples)))
    # 64 MB of correlations at a time, which a matrix product fills fast and the search of their
    # largest values then finds in the cache or near it.
    step = max(1, (1 << 24) // len(centred))
    for start in range(0, len(samples), step):
        part = samples[start : start + step]
        # Columns of `directions` sum to 0, so that the mean of the samples does not matter.
        scores = part @ directions
        energy = np.maximum(part.var(axis=1, dtype=np.float64) * part.shape[1], 1e-30)
        some = np.arange(len(part))
        for place in (0, 1):
            best = scores.argmax(axis=1)
            fit = np.maximum(scores[np.arange(len(best)), best], 0).astype(np.float64) ** 2
            line[place, start + some] = best // 2
            share[place, start + some] = np.minimum(fit / energy[some], 1 - 1e-12)
            weak = share[place, start + some] < 0.98
            some, scores = some[weak], scores[weak]
            near = best[weak, None] + np.arange(-2 * _OPEN, 2 * _OPEN + 1)
            scores[np.arange(len(near))[:, None], near.clip(0, len(centred) - 1)] = -np.inf
    return line, share


def read_code(codes: Codes, code: Code, values: Singles, clipped: NDArray[np.bool_]) -> Reading:
    """What camera pixels with samples (m, K) see along the axis of a code.

    Samples that are `clipped` (m, K) are lower bounds, which bits with inverses endure.

    A camera pixel that sees parts of two neighbouring lines has samples that are a mixture of their
    values: least squares gives the shares (and the constant light).
    """
    samples = np.ascontiguousarray(values[:, code.frames])
    k = samples.shape[1]
    if code.bits:
        line = codes.lines(code, np.ascontiguousarray(values.T), np.arange(values.shape[1]))
    else:
        (line, other), shares = correlate(code, samples)
    known, free = np.maximum(line, 0), ~clipped[:, code.frames]
    own = samples - samples.mean(axis=1, keepdims=True)
    energy = np.einsum("ij,ij->i", own, own).astype(np.float64)
    offset, light, fit = _mixture(code, own, known)
    explained = np.clip(fit / np.maximum(energy, 1e-30), 0, 1)
    variance = np.maximum(np.maximum(energy - fit, 0) / max(1, k - 3), USUAL_NOISE**2)
    # How far the values move per line.
    change = np.sqrt((np.gradient(code.centred.astype(np.float64), axis=0) ** 2).sum(axis=1))
    slope = np.maximum(change, 1e-6)[known] * np.maximum(light, 1e-12)
    place, uncertainty = known + offset, np.sqrt(variance) / slope
    wide = np.flatnonzero((line >= 0) & (uncertainty > 0.2))
    # Pieces of so many samples bound the memory.
    for part in np.array_split(wide, 1 + len(wide) * k // (1 << 19)):
        mean, spread = _open_place(code, own[part], known[part], variance[part])
        # Within two lines their mixture is more exact.
        moves = (spread > 0.75) & free[part].all(axis=1)
        place[part] = np.where(moves, mean, place[part])
        uncertainty[part] = np.hypot(uncertainty[part], spread)
    if not code.bits:
        # The spread of two places by their likelihoods under noise of unknown size; once in a
        # hundred, a place may be wrong.
        odds = ((1 - np.maximum(explained, shares[0])) / (1 - shares[1])) ** ((k - 2) / 2)
        rival = np.abs(other - line) * np.sqrt(odds) / (1 + odds)
        uncertainty = np.hypot(uncertainty, np.where(odds > 0.01, rival, 0))
    evidence = _evidence(code, own, known, explained)
    bounded = np.flatnonzero((line >= 0) & ~free.all(axis=1) & (not code.paired))
    # Pieces of so few samples stay in the cache, which takes less than half the time.
    for part in np.array_split(bounded, 1 + len(bounded) * k // (1 << 13)):
        near = [known[part], *correlate(code, samples[part])[0]]
        place[part], uncertainty[part] = _bounded_place(code, samples[part], free[part], near)
        explained[part] *= _FINE / np.sqrt(12) / uncertainty[part]
    width = np.diff(code.starts)[known]
    return Reading(
        np.where(line >= 0, code.places(place), np.nan),
        light,
        explained,
        np.sqrt((uncertainty * width) ** 2 + (width**2 - 1) / 12),
        evidence,
    )


def _mixture(
    code: Code, own: Singles, line: Indices
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The samples of mean 0, (m, k), as a mixture of their line's values and a neighbour's.

    Returns the place from the line on, the light of both, and the energy that they explain.
    """
    centred, square = code.centred, code.squares
    product = (centred[:-1].astype(np.float64) * centred[1:]).sum(axis=1)
    here = np.einsum("ij,ij->i", own, centred[line]).astype(np.float64)
    light = here / square[line]
    fit = light * here
    offset = np.zeros(len(line))
    for side in (-1, 1):
        other = np.clip(line + side, 0, len(centred) - 1)
        there = np.einsum("ij,ij->i", own, centred[other]).astype(np.float64)
        cross = product[np.minimum(np.minimum(line, other), len(product) - 1)]
        determinant = square[line] * square[other] - cross**2
        with np.errstate(invalid="ignore", divide="ignore"):
            first = (square[other] * here - cross * there) / determinant
            second = (square[line] * there - cross * here) / determinant
            share = second / (first + second)
        mixed = (other != line) & (second > 0) & (first > 0)
        offset += np.where(mixed, side * share, 0)
        better = mixed & (first * here + second * there > fit)
        light = np.where(better, first + second, light)
        fit = np.where(better, first * here + second * there, fit)
    return offset, light, fit


def _open_place(
    code: Code, own: Singles, line: Indices, variance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of the places around a line by their likelihoods, (m,).

    Where the camera does not resolve the finest stripes, their samples are grey and fit several
    lines about as well as the best one.
    """
    square = code.squares
    near = line[:, None] + np.arange(-_OPEN, _OPEN + 1)
    inside = (near >= 0) & (near < len(square))
    near = np.clip(near, 0, len(square) - 1)
    fits = np.einsum("mk,mnk->mn", own, code.centred[near]).astype(np.float64)
    fits = np.where(inside, np.maximum(fits, 0) ** 2 / square[near], -np.inf)
    less = (fits.max(axis=1, keepdims=True) - fits) / (2 * variance[:, None])
    weight = np.exp(-less)
    weight /= weight.sum(axis=1, keepdims=True)
    mean = (weight * near).sum(axis=1)
    return mean, np.sqrt((weight * (near - mean[:, None]) ** 2).sum(axis=1))


def _bounded_place(
    code: Code, samples: Singles, free: NDArray[np.bool_], lines: list[Indices]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of the places around `lines`, (m,) each, by their likelihoods.

    Samples (m, k) that are not `free` are lower bounds: they count where a place explains less.
    """
    places = np.concatenate([line[:, None] + np.arange(-2, 2.01, _FINE) for line in lines], axis=1)
    first = np.clip(places.astype(np.int64), 0, len(code.values) - 2)
    share = np.asarray(places - first, np.float32)[..., None]
    values = (1 - share) * code.values[first] + share * code.values[first + 1]
    counted, light = np.ones(values.shape, np.float32), np.zeros(1, np.float32)
    # Which bounds count settles within five rounds. The light stays where only bounds tell of it.
    for _ in range(5):
        counted /= np.maximum(counted.sum(axis=2, keepdims=True), 1)
        centred = values - (counted * values).sum(axis=2, keepdims=True)
        rest = samples[:, None] - (counted * samples[:, None]).sum(axis=2, keepdims=True)
        light = (counted * centred * rest).sum(axis=2, keepdims=True) + 1e-4 * light
        light = np.maximum(light / ((counted * centred**2).sum(axis=2, keepdims=True) + 1e-4), 1e-3)
        rest -= light * centred
        counted = np.asarray(free[:, None] | (rest > 0), np.float32)
    energy = (counted * rest**2).sum(axis=2, dtype=np.float64)
    energy[(places < 0) | (places > len(code.values) - 1)] = np.inf
    least = energy.min(axis=1, keepdims=True)
    noise = np.maximum(least / np.maximum(free.sum(axis=1, keepdims=True) - 3, 1), USUAL_NOISE**2)
    # Much light is less likely; of its powers, the square errs least on four overexposed scenes.
    weight = np.exp((least - energy) / (2 * noise)) / light[..., 0] ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    mean = (weight * places).sum(axis=1)
    return mean, np.sqrt((weight * (places - mean[:, None]) ** 2).sum(axis=1) + _FINE**2 / 12)


def _evidence(
    code: Code, own: Singles, line: Indices, explained: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How much likelier lines make samples of mean 0, (m, k), than chance, as a logarithm, (m,).

    The best of n lines explains noise of d dimensions but for a share of about n^(-2 / d). Frames
    whose stripes the camera does not resolve explain nothing, so the coarsest frames are tried by
    themselves too.
    """

    def logarithm(share: NDArray[np.float64], frames: int, lines: int) -> NDArray[np.float64]:
        left = np.maximum(1 - share, 1e-12)
        return np.asarray(-0.5 * (frames - 2) * np.log(left) - np.log(lines))

    best = logarithm(explained, own.shape[1], len(code.values))
    changes = code.changes
    for most in np.unique(changes)[-2::-1]:
        frames = np.flatnonzero(changes <= most)
        some = np.flatnonzero(best < 10)
        if len(frames) < 4 or not len(some):
            break
        shown = code.values[line[some][:, None], frames]
        shown = shown - shown.mean(axis=1, keepdims=True)
        seen = own[some][:, frames]
        seen = seen - seen.mean(axis=1, keepdims=True)
        both = np.maximum(np.einsum("ij,ij->i", seen, shown), 0).astype(np.float64) ** 2
        power = np.einsum("ij,ij->i", seen, seen) * np.einsum("ij,ij->i", shown, shown)
        lines = len(np.unique(code.values[:, frames], axis=0))
        found = logarithm(both / np.maximum(power, 1e-30), len(frames), lines)
        best[some] = np.maximum(best[some], found)
    return best
