"""`lm.decode`: the correspondence of a capture under stripes, without an estimate of T."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CORRESPONDENCE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import COLUMNS, NOTHING, ROWS, Stripes, stripes_of
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.npz import write_correspondence

# Which code the patterns show, read from the patterns themselves, in whatever order.


# Grey values that differ by less than one level of 8 bits are the same.
_LEVEL = 1 / 255


@dataclass(frozen=True, eq=False)
class Code:
    """The values that number the projector's pixels along one axis, COLUMNS or ROWS."""

    axis: int
    # (k,): the patterns of the code; of a code without inverses, white and black too.
    frames: NDArray[np.int64]
    # (length, k): the value of each projector pixel in each of these patterns.
    values: NDArray[np.float32]
    # The patterns of each bit and of its inverse, as indices into `frames`; -1 where there is no
    # inverse. Empty if some value is grey.
    bits: tuple[tuple[int, int], ...]

    @cached_property
    def centred(self) -> NDArray[np.float32]:
        """The values of each pixel less their mean, (length, k): without the constant light."""
        return np.asarray(self.values - self.values.mean(axis=1, keepdims=True), np.float32)

    @cached_property
    def words(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The bits of each pixel as a number, ascending, and the pixel of each, (length,) both."""
        lit = self.values[:, [frame for frame, _ in self.bits]] > 0.5
        word = (lit.astype(np.int64) << np.arange(len(self.bits))).sum(axis=1)
        order = np.argsort(word)
        return word[order], order


@dataclass(frozen=True, eq=False)
class Codes:
    """The codes of a capture, and its uniform patterns: the brightest and the darkest, or None."""

    codes: tuple[Code, ...]
    white: int | None
    black: int | None


def find_codes(patterns: PatternSet) -> Codes:
    """The codes of the columns and of the rows.

    An InputError says that a pattern varies along both, or that the patterns of an axis show two of
    its pixels alike.
    """
    stripes = stripes_of(patterns)
    if stripes is None:
        raise InputError(
            "these patterns are no stripes: one varies along both rows and columns",
            hint="estimate T from them with `estimate`",
        )
    uniform = np.flatnonzero(stripes.axes == NOTHING)
    levels = [float(stripes.profiles[k][0]) for k in uniform]
    white = black = None
    if levels and max(levels) > 1 - _LEVEL:
        white = int(uniform[int(np.argmax(levels))])
    if levels and min(levels) < _LEVEL:
        black = int(uniform[int(np.argmin(levels))])
    ends = [(k, value) for k, value in ((white, 1), (black, 0)) if k is not None]
    found = tuple(
        _code(stripes, axis, patterns.shape[axis], ends)
        for axis in (COLUMNS, ROWS)
        if (stripes.axes == axis).any()
    )
    if not found:
        raise InputError("no pattern varies", hint="project a code, such as Gray code")
    return Codes(found, white, black)


def _code(stripes: Stripes, axis: int, length: int, ends: list[tuple[int, int]]) -> Code:
    """The code of an axis; `ends` are the white and the black pattern, as far as there are any."""
    frames = np.flatnonzero(stripes.axes == axis)
    values = np.stack([stripes.profiles[k] for k in frames], axis=1)
    distinct = len(np.unique(np.rint(values / _LEVEL), axis=0))
    if distinct < length:
        lines = "columns" if axis == COLUMNS else "rows"
        raise InputError(
            f"the {len(frames)} patterns along {lines} tell only {distinct} of {length} {lines} "
            "apart",
            hint="is a pattern missing? project the whole code, or bin the projector less",
        )
    bits = _bits(values)
    if any(inverse < 0 for _, inverse in bits):
        # Without inverses, the words of only 0 or only 1 are as constant as no light at all. White
        # and black tell them apart; where there are inverses, they would only add global light.
        frames = np.concatenate([frames, [k for k, _ in ends]]).astype(np.int64)
        constant = [np.full((length, 1), value, np.float32) for _, value in ends]
        values = np.concatenate([values, *constant], axis=1)
    return Code(axis, frames, values, bits)


def _bits(values: NDArray[np.float32]) -> tuple[tuple[int, int], ...]:
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


# Which projector pixel along an axis each camera pixel sees, from its samples under the code.


@dataclass(frozen=True, eq=False)
class Reading:
    """What m camera pixels see along one axis."""

    # The projector pixel; -1 where the samples are no word of the code. Then to fractions of it.
    pixel: NDArray[np.int64]
    place: NDArray[np.float64]
    # How much brighter a lit projector pixel makes the camera pixel than a dark one, in units of
    # the clip level.
    light: NDArray[np.float64]
    # Share of the samples' variance that the code explains, in [0, 1].
    explained: NDArray[np.float64]
    # Standard deviation of the place, in projector pixels.
    uncertainty: NDArray[np.float64]


def correlate(code: Code, samples: NDArray[np.float32]) -> NDArray[np.int64]:
    """The projector pixel whose values correlate best with each camera pixel's samples (m, k).

    The most likely one under noise that is the same in all samples, whatever the surface and the
    constant light (Mirdehghan et al. 2018). Places half way between two pixels are tried too: few
    patterns of short periods resemble them elsewhere better than in their neighbours.
    """
    centred = np.empty((2 * len(code.values) - 1, samples.shape[1]), np.float32)
    centred[::2] = code.centred
    centred[1::2] = (code.centred[1:] + code.centred[:-1]) / 2
    length = np.sqrt((centred**2).sum(axis=1, keepdims=True))
    directions = np.ascontiguousarray((centred / np.maximum(length, 1e-12)).T)
    pixel = np.empty(len(samples), np.int64)
    # 64 MB of correlations at a time, which a matrix product fills fast and the search of their
    # largest values then finds in the cache or near it.
    step = max(1, (1 << 24) // len(centred))
    for start in range(0, len(samples), step):
        part = samples[start : start + step]
        # Columns of `directions` sum to 0, so that the mean of the samples does not matter.
        pixel[start : start + step] = (part @ directions).argmax(axis=1) // 2
    return pixel


def refine(code: Code, samples: NDArray[np.float32], pixel: NDArray[np.int64]) -> Reading:
    """The place to fractions of a pixel, and how well the code fits the samples (m, k).

    A camera pixel that sees parts of two neighbouring projector pixels has samples that are a
    mixture of their values: least squares gives the shares (and the constant light).
    """
    k = samples.shape[1]
    known = np.maximum(pixel, 0)
    centred = code.centred
    own = samples - samples.mean(axis=1, keepdims=True)
    energy = np.einsum("ij,ij->i", own, own).astype(np.float64)
    # A constant word has no light, and divides nothing by 0.
    square = np.maximum((centred.astype(np.float64) ** 2).sum(axis=1), 1e-12)
    product = (centred[:-1].astype(np.float64) * centred[1:]).sum(axis=1)
    here = np.einsum("ij,ij->i", own, centred[known]).astype(np.float64)
    light = here / square[known]
    fit = light * here
    offset = np.zeros(len(pixel))
    for side in (-1, 1):
        other = np.clip(known + side, 0, len(code.values) - 1)
        there = np.einsum("ij,ij->i", own, centred[other]).astype(np.float64)
        cross = product[np.minimum(np.minimum(known, other), len(product) - 1)]
        determinant = square[known] * square[other] - cross**2
        with np.errstate(invalid="ignore", divide="ignore"):
            first = (square[other] * here - cross * there) / determinant
            second = (square[known] * there - cross * here) / determinant
            share = second / (first + second)
        mixed = (other != known) & (second > 0) & (first > 0)
        offset += np.where(mixed, side * share, 0)
        better = mixed & (first * here + second * there > fit)
        light = np.where(better, first + second, light)
        fit = np.where(better, first * here + second * there, fit)
    noise = np.sqrt(np.maximum(energy - fit, 0) / max(1, k - 3))
    # How far the values move per projector pixel.
    change = np.sqrt((np.gradient(centred.astype(np.float64), axis=0) ** 2).sum(axis=1))
    slope = np.maximum(change, 1e-6)[known] * np.maximum(light, 1e-12)
    return Reading(
        pixel,
        np.where(pixel >= 0, pixel + offset, np.nan),
        light,
        np.clip(fit / np.maximum(energy, 1e-30), 0, 1),
        np.maximum(noise, USUAL_NOISE) / slope,
    )


def decode(
    capture: Capture | str | Path,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Correspondence:
    """Decode a capture under stripes: Gray code, phase shifts, micro phase shifts, and others.

    The code is read from the patterns themselves. They may come in any order, with or without
    inverse, white and black patterns, along columns, rows, or both. Black and white codes are
    decoded bit by bit, any other by the best correlation with the samples; then the samples are
    explained as a mixture of two neighbouring projector pixels, for the place within the pixel.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture or its folder. Channels of a colour camera are added.
    output : str or Path, optional
        The file to write: .npz, which `triangulate` and `read_correspondence` read.
    overwrite : bool
        Whether an existing correspondence may be replaced.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Correspondence
        Pixel, place, confidence (the share of the samples' variance that the code explains), its
        uncertainty and the direct light of each camera pixel. Where the patterns vary along columns
        only, rows are -1 and NaN, and vice versa.

    Raises
    ------
    InputError
        If a pattern is no stripes, or the patterns of an axis show two of its pixels alike.
    OutputError
        If the file exists or cannot be written.

    References
    ----------
    Inokuchi et al. 1984 (Gray code); Mirdehghan, Chen & Kutulakos 2018 (correlation).

    Examples
    --------
    >>> import lightmatrix as lm
    >>> code = lm.make_patterns("graycode", (64, 64), inverse=True)
    >>> matches = lm.decode(lm.simulate("metal", code, exposure=0.2))
    >>> matches.pixel[20, 30].tolist()
    [20, 30]
    """
    if output is not None:
        check_output(output, CORRESPONDENCE, overwrite=overwrite)
    opened = open_capture(capture)
    codes = find_codes(opened.patterns)
    shape = opened.camera_shape
    channels = shape[2] if len(shape) == 3 else 1
    count = shape[0] * shape[1]
    pixel = np.full((count, 2), -1, np.int32)
    place = np.full((count, 2), np.nan, np.float32)
    uncertainty = np.full((count, 2), np.nan, np.float32)
    confidence, light = np.zeros(count, np.float32), np.zeros(count, np.float32)
    # Temporary arrays of this many camera samples times frames stay below 300 MB.
    step = channels * max(1, (1 << 23) // (channels * opened.count))
    for start, tile in opened.tiles(step):
        usable = np.asarray(tile.counted.reshape(-1, channels, opened.count).any(axis=(1, 2)))
        values = np.asarray(tile.values, np.float32)
        if channels > 1:
            values = values.reshape(-1, channels, opened.count).sum(axis=1)
        rows = slice(start // channels, start // channels + len(values))
        readings = {code.axis: _read(code, codes, values) for code in codes.codes}
        for reading in readings.values():
            # A camera pixel sees the projector if its direct light exceeds five standard deviations
            # of a decent camera's noise.
            usable &= (reading.pixel >= 0) & (reading.light > 5 * USUAL_NOISE)
        for axis, reading in readings.items():
            pixel[rows, axis] = np.where(usable, reading.pixel, -1)
            place[rows, axis] = np.where(usable, reading.place, np.nan)
            uncertainty[rows, axis] = np.where(usable, reading.uncertainty, np.nan)
        explained = np.min([reading.explained for reading in readings.values()], axis=0)
        confidence[rows] = np.where(usable, explained, 0)
        mean = np.mean([reading.light for reading in readings.values()], axis=0)
        light[rows] = np.where(usable, mean, 0)
        if progress is not None:
            progress(min(start + step, opened.rows), opened.rows)
    grid = (shape[0], shape[1])
    result = Correspondence(
        pixel.reshape(*grid, 2),
        place.reshape(*grid, 2),
        confidence.reshape(grid),
        uncertainty.reshape(*grid, 2),
        light.reshape(grid),
        opened.projector_shape,
    )
    if output is not None:
        write_correspondence(output, result, overwrite=overwrite)
    return result


def _read(code: Code, codes: Codes, values: NDArray[np.float32]) -> Reading:
    """What camera pixels with these samples (m, K) see along the axis of a code."""
    samples = np.ascontiguousarray(values[:, code.frames])
    if not code.bits:
        return refine(code, samples, correlate(code, samples))
    bright = samples.max(axis=1) if codes.white is None else values[:, codes.white]
    dark = samples.min(axis=1) if codes.black is None else values[:, codes.black]
    middle = np.asarray((bright + dark) / 2, np.float32)
    word = np.zeros(len(samples), np.int64)
    for place, (frame, inverse) in enumerate(code.bits):
        # The brighter of a pattern and its inverse decides a bit; without inverse, whether the
        # sample is above the middle of black and white.
        threshold = middle if inverse < 0 else samples[:, inverse]
        word |= (samples[:, frame] > threshold).astype(np.int64) << place
    words, pixels = code.words
    found = np.minimum(np.searchsorted(words, word), len(words) - 1)
    return refine(code, samples, np.where(words[found] == word, pixels[found], -1))
