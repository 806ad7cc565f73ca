"""Patterns of stripes: each varies along the projector's columns, or along its rows, or not at all.

The codes of structured light are of this kind: Gray code, phase shifts, micro phase shifts.
"""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet, check_geometry
from lightmatrix.ranges import as_float

# What a pattern varies along: its columns (upright stripes), its rows, or nothing (white, black).
COLUMNS, ROWS, NOTHING = 1, 0, -1
# Pixels of a stripe are the same if they differ by at most this share of white: saving grey values
# with 8 bits and a projector's response curve leave no difference, lossy compression a small one.
_SAME = 0.02


@dataclass(frozen=True, eq=False)
class Stripes:
    """K patterns of stripes, each by the values along what it varies.

    Parameters
    ----------
    axes : (K,) int
        COLUMNS, ROWS or NOTHING for each pattern.
    profiles : tuple of K arrays, float32
        (cols,) values along the columns, (rows,) along the rows, or (1,) of a uniform pattern.
    """

    axes: NDArray[np.int64]
    profiles: tuple[NDArray[np.float32], ...]

    @classmethod
    def of(cls, parts: Iterable[tuple[int, NDArray[np.float32]]]) -> "Stripes":
        """The stripes of several profiles (k, length) along each of some axes."""
        pairs = [(axis, profile) for axis, profiles in parts for profile in profiles]
        return cls(np.array([axis for axis, _ in pairs]), tuple(profile for _, profile in pairs))


class StripePatterns(PatternSet):
    """Patterns of stripes as an operator: sums over rows or columns, then a small product."""

    @property
    @abstractmethod
    def stripes(self) -> Stripes:
        """Axis and profile of each pattern."""

    @property
    def count(self) -> int:  # type: ignore[override]
        return len(self.stripes.profiles)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        images = x.reshape(len(x), *self.shape)
        sums = {ROWS: images.sum(axis=2), COLUMNS: images.sum(axis=1)}
        samples = np.empty((len(x), self.count), x.dtype)
        for axis, light in sums.items():
            frames, profiles = self._along[axis]
            samples[:, frames] = light @ profiles.astype(x.dtype).T
        return samples

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        parts = []
        for frames, profiles in self._along.values():
            parts.append(e[:, frames] @ profiles.astype(e.dtype))
        return np.asarray(parts[0][:, :, None] + parts[1][:, None, :]).reshape(len(e), self.pixels)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        place = np.divmod(np.asarray(index, np.int64), self.shape[1])
        values = np.empty((self.count, len(place[0])), np.float32)
        for axis, (frames, profiles) in self._along.items():
            values[frames] = profiles[:, place[axis]]
        return values

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        images = np.empty((min(stop, self.count) - start, *self.shape), np.float32)
        for k, image in enumerate(images, start):
            profile = self.stripes.profiles[k]
            image[:] = profile[:, None] if self.stripes.axes[k] == ROWS else profile
        return images.reshape(len(images), self.pixels)

    @cached_property
    def _along(self) -> dict[int, tuple[NDArray[np.int64], NDArray[np.float32]]]:
        """The patterns along each axis, with uniform ones among the rows, and their values."""
        result = {}
        for axis in (ROWS, COLUMNS):
            chosen = self.stripes.axes == axis
            if axis == ROWS:
                chosen |= self.stripes.axes == NOTHING
            frames = np.flatnonzero(chosen)
            values = np.empty((len(frames), self.shape[axis]), np.float32)
            for value, k in zip(values, frames, strict=True):
                value[:] = self.stripes.profiles[k]
            result[axis] = frames, values
        return result


def stripes_of(patterns: PatternSet) -> Stripes | None:
    """The patterns as stripes; None if one of them varies along both rows and columns."""
    if isinstance(patterns, StripePatterns):
        return patterns.stripes
    axes, profiles = [], []
    for k in range(patterns.count):
        image = patterns.images(k, k + 1)[0]
        # A pattern of two rows that differ varies along rows, one of equal rows does not.
        upright = bool((np.abs(image - image[:1]) <= _SAME).all())
        level = bool((np.abs(image - image[:, :1]) <= _SAME).all())
        if upright and level:
            axes.append(NOTHING)
            profiles.append(np.full(1, image.mean(), np.float32))
        elif upright or level:
            axes.append(COLUMNS if upright else ROWS)
            profiles.append(image.mean(axis=0 if upright else 1, dtype=np.float32))
        else:
            return None
    return Stripes(np.array(axes), tuple(profiles))


def check_code_shape(shape: tuple[int, int]) -> None:
    """Refuse projectors of one pixel, which nothing can encode."""
    check_geometry(shape, 1)
    if max(shape) < 2:
        hint = "give (rows, cols), one above 1"
        raise InputError(f"a code for a projector of shape {shape}", hint=hint)


def both_axes(shape: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """Axis and length of the columns, then of the rows; an axis of one pixel needs no code."""
    lengths = ((COLUMNS, shape[1]), (ROWS, shape[0]))
    return tuple((axis, length) for axis, length in lengths if length > 1)


def is_separable(patterns: PatternSet) -> bool:
    """Whether no pattern varies along both rows and columns."""
    if min(patterns.shape) == 1:
        return False
    stripes = stripes_of(patterns)
    return stripes is not None and bool((stripes.axes != NOTHING).any())


@dataclass(frozen=True, eq=False)
class GrayCodePatterns(StripePatterns):
    """Gray code of the columns, then of the rows, then white and black.

    Neighbouring stripes differ in one bit, so that a camera pixel on an edge is off by one stripe
    at most (Inokuchi et al. 1984). The bits come from the coarsest to the finest.

    Parameters
    ----------
    inverse : bool
        Whether each bit is followed by its inverse. The brighter of the two decides a bit, whatever
        the surface and the global light.
    """

    shape: tuple[int, int]
    inverse: bool = False

    kind: ClassVar[str] = "graycode"

    def __post_init__(self) -> None:
        check_code_shape(self.shape)

    @cached_property
    def stripes(self) -> Stripes:
        codes = [
            (axis, with_inverses(gray_bits(np.arange(length)), self.inverse))
            for axis, length in both_axes(self.shape)
        ]
        return Stripes.of([*codes, (NOTHING, np.array([[1], [0]], np.float32))])


def gray_bits(number: NDArray[np.int64]) -> NDArray[np.float32]:
    """Bits of the Gray code of the number of each pixel, the coarsest first, (bits, length)."""
    gray = number ^ (number >> 1)
    places = np.arange(int(number.max()).bit_length())[::-1]
    return ((gray >> places[:, None]) & 1).astype(np.float32)


def with_inverses(bits: NDArray[np.float32], inverse: bool) -> NDArray[np.float32]:
    """The bits (n, length), each followed by its inverse if asked for."""
    if not inverse:
        return bits
    return np.stack([bits, 1 - bits], axis=1).reshape(-1, bits.shape[1])


@dataclass(frozen=True, eq=False)
class PhasePatterns(StripePatterns):
    """Gray code down to half periods, and four shifts of a sinusoid, of columns, then of rows.

    The sinusoid places a camera pixel to fractions of a projector pixel within its period; the code
    says which period it is (Sansoni et al. 1999). Its stripes are half a period wide, so that an
    edge between them never lies where the phase starts anew.

    Parameters
    ----------
    period : float
        Projector pixels of a period, at least 3. Short periods place a pixel more finely, but a
        projector out of focus by a pixel leaves a quarter less of 8 pixels' contrast.
    inverse : bool
        Whether each bit of the Gray code is followed by its inverse.
    """

    shape: tuple[int, int]
    period: float = 8.0
    inverse: bool = False

    kind: ClassVar[str] = "phase"

    def __post_init__(self) -> None:
        check_code_shape(self.shape)
        check_period(self.period)

    @cached_property
    def stripes(self) -> Stripes:
        codes = []
        for axis, length in both_axes(self.shape):
            pixel = np.arange(length)
            bits = gray_bits((2 * pixel / self.period).astype(np.int64))
            waves = sinusoid(pixel / self.period - np.arange(4)[:, None] / 4)
            codes.append((axis, np.concatenate([with_inverses(bits, self.inverse), waves])))
        return Stripes.of(codes)


def sinusoid(phase: NDArray[np.float64]) -> NDArray[np.float32]:
    """Grey values in [0, 1] at phases in periods, as 8 bits can show them."""
    return (np.rint(255 * (0.5 + 0.5 * np.cos(2 * np.pi * phase))) / 255).astype(np.float32)


def check_period(period: float) -> None:
    """Refuse periods that pixels cannot show."""
    if not 3 <= as_float(period) < np.inf:
        hint = "use at least 3, such as 8 or 16"
        raise InputError(f"a period of {period} projector pixels", hint=hint)


# Periods lie within this share of their mean, as in the paper: all are then short, which is what
# makes global light the same in all photographs.
_BAND = 0.2


@dataclass(frozen=True, eq=False)
class MicroPhasePatterns(StripePatterns):
    """Three shifts of one sinusoid and one of each further period; of columns, then of rows.

    All patterns are fine, so that light from many places, as between concave surfaces, adds the
    same amount to each photograph. F periods need F + 2 patterns (Gupta & Nayar 2012, Eq. 9). The
    defaults are those of the paper's experiments, with five periods.

    Parameters
    ----------
    total : int
        Number of patterns: an equal number, at least 5, for the columns and for the rows.
    period : float
        Mean period in projector pixels, at least 3.
    """

    shape: tuple[int, int]
    total: int = 14
    period: float = 16.0

    kind: ClassVar[str] = "microphase"

    def __post_init__(self) -> None:
        check_code_shape(self.shape)
        check_period(as_float(self.period) * (1 - _BAND))
        axes = len(both_axes(self.shape))
        check_geometry(self.shape, self.total)
        # An axis needs three shifts of one period, and one of each of two more.
        if self.total % axes or self.total < 5 * axes:
            hint = f"ask for an even number from {5 * axes} on, such as 14"
            raise InputError(f"{self.total} micro phase shifts for columns and rows", hint=hint)

    @cached_property
    def stripes(self) -> Stripes:
        axes = both_axes(self.shape)
        count = self.total // len(axes) - 2
        return Stripes.of(
            (axis, _profiles(np.arange(length, dtype=float), _periods(length, count, self.period)))
            for axis, length in axes
        )


def _profiles(pixel: NDArray[np.float64], periods: NDArray[np.float64]) -> NDArray[np.float32]:
    """Grey values of all patterns at these pixels, (patterns, pixels)."""
    first = pixel[None, :] / periods[0] - np.arange(3)[:, None] / 3
    return sinusoid(np.concatenate([first, pixel[None, :] / periods[1:, None]]))


def _periods(length: int, count: int, mean: float) -> NDArray[np.float64]:
    """Periods in projector pixels by which distant pixels differ most, (count,)."""
    # The random set is chosen in which the most similar codes of two pixels, at least half a period
    # apart, correlate least. 200 sets take milliseconds to compare.
    draws = np.random.default_rng(0).uniform(1 - _BAND, 1 + _BAND, (200, count))
    sets = np.sort(mean * draws, axis=1)
    pixel = np.arange(length, dtype=float)
    # Only 128 pixels are compared with all others: large projectors then take a second at most.
    some = np.unique(np.linspace(0, length - 1, 128).astype(np.int64))
    distant = np.abs(pixel[:, None] - pixel[some]) >= mean / 2
    if not distant.any():
        return np.asarray(sets[0])
    alike = []
    for periods in sets:
        codes = _profiles(pixel, periods)
        codes = codes - codes.mean(axis=0)
        codes /= np.maximum(np.linalg.norm(codes, axis=0), 1e-6)
        alike.append(float((codes.T @ codes[:, some])[distant].max()))
    return np.asarray(sets[int(np.argmin(alike))])
