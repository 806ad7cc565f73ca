"""Patterns of a colour projector: three grids of pixels side by side, red, green and blue."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns, BitPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet, check_geometry
from lightmatrix.ranges import whole


@dataclass(frozen=True, eq=False, repr=False)
class ColourPatterns(PatternSet):
    """K patterns of a colour projector, which shows red, green and blue at once.

    As an operator it is one projector of (rows, 3 cols) pixels: the grids of red, green and blue
    side by side. In a folder each pattern is one colour image.

    Parameters
    ----------
    red, green, blue : PatternSet
        What each primary shows, K patterns of (rows, cols). A pattern is grey if all three agree.

    Raises
    ------
    InputError
        If the three differ in number or size.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> primaries = [lm.BernoulliPatterns((8, 8), 4, seed=seed) for seed in range(3)]
    >>> patterns = lm.ColourPatterns(*primaries)
    >>> patterns.shape, patterns.colour_images(0, 2).shape, patterns.grey.any()
    ((8, 24), (2, 8, 8, 3), np.False_)
    """

    red: PatternSet
    green: PatternSet
    blue: PatternSet

    def __post_init__(self) -> None:
        for other in (self.green, self.blue):
            if (other.shape, other.count) != (self.red.shape, self.red.count):
                raise InputError(
                    f"{self.red.count} patterns {self.red.shape} in red, and {other.count} "
                    f"{other.shape} in another primary",
                    hint="give red, green and blue as many patterns of the same size",
                )

    @property
    def primaries(self) -> tuple[PatternSet, PatternSet, PatternSet]:
        """What red, green and blue show."""
        return self.red, self.green, self.blue

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]
        rows, cols = self.red.shape
        return rows, 3 * cols

    @property
    def count(self) -> int:  # type: ignore[override]
        return self.red.count

    @cached_property
    def grey(self) -> NDArray[np.bool_]:
        """Whether red, green and blue show the same, (K,)."""
        same = np.ones(self.count, bool)
        for start, chunk in self.red.chunks():
            stop = start + len(chunk)
            for other in (self.green, self.blue):
                same[start:stop] &= (other.rows(start, stop) == chunk).all(axis=1)
        return same

    def colour_images(self, start: int = 0, stop: int | None = None) -> NDArray[np.float32]:
        """Patterns as colour images, (stop - start, rows, cols, 3) in [0, 1]."""
        return np.stack([one.images(start, stop) for one in self.primaries], axis=-1)

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        # Each row of pixels holds those of red, then of green, then of blue.
        side_by_side = [one.images(start, stop) for one in self.primaries]
        return np.concatenate(side_by_side, axis=2).reshape(-1, self.pixels)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        parts = [one.forward(part) for one, part in zip(self.primaries, self._cut(x), strict=True)]
        return np.asarray(parts[0] + parts[1] + parts[2])

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        parts = [one.adjoint(e).reshape(-1, *self.red.shape) for one in self.primaries]
        return np.concatenate(parts, axis=2).reshape(-1, self.pixels)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        cols = self.red.shape[1]
        row, place = np.divmod(np.asarray(index), 3 * cols)
        primary, col = np.divmod(place, cols)
        found = np.empty((self.count, len(row)), np.float32)
        for number, one in enumerate(self.primaries):
            mine = primary == number
            found[:, mine] = one.columns((row * cols + col)[mine])
        return found

    def subset(self, index: NDArray[np.integer]) -> "ColourPatterns":
        red, green, blue = (one.subset(index) for one in self.primaries)
        return ColourPatterns(red, green, blue)

    def coarse(self, block: tuple[int, int]) -> "ColourPatterns":  # type: ignore[override]
        """The patterns averaged over blocks of each primary's (rows, cols) pixels."""
        red, green, blue = (one.coarse(block) for one in self.primaries)
        return ColourPatterns(red, green, blue)

    def _cut(self, x: NDArray[Any]) -> Iterator[NDArray[Any]]:
        """The parts of vectors (M, 3 N) that belong to each primary, (M, N)."""
        whole = x.reshape(-1, *self.shape)
        for part in np.split(whole, 3, axis=2):
            yield np.ascontiguousarray(part).reshape(len(x), -1)

    @property
    def description(self) -> dict[str, Any]:
        shape = [*self.red.shape, 3]
        return {"kind": "images", "shape": shape, "count": self.count}


def colour_bernoulli(
    shape: tuple[int, int],
    count: int,
    *,
    grey: int | None = None,
    density: float = 0.5,
    seed: int = 0,
) -> ColourPatterns:
    """Random patterns of a colour projector: some in grey, then each primary by itself.

    Parameters
    ----------
    shape : (rows, cols)
        Projector pixels.
    count : int
        Number of patterns K.
    grey : int, optional
        How many of them are grey. None: half of them, at most 16.
    density : float
        Share of lit pixels, in (0, 1).
    seed : int
        Seed of the draw.

    Returns
    -------
    ColourPatterns

    Raises
    ------
    InputError
        On values out of range, or without a pattern in colour.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.colour_bernoulli((16, 16), 32)
    >>> int(patterns.grey.sum()), patterns.count
    (16, 32)
    """
    check_geometry(shape, count)
    # Grey patterns before the coloured ones, unless stated: half of all, at most 16. From 16 on
    # they show where each camera pixel looks; below 12 they often do not (docs/colour.md).
    alike = min(count // 2, 16) if grey is None else grey
    if not 0 <= (-1 if whole(alike) is None else alike) < count:
        hint = "leave one at least that is in colour"
        raise InputError(f"{alike} grey patterns of {count}", hint=hint)
    # The grey ones come first, so that they are those of a capture without colour.
    drawn = BernoulliPatterns(shape, alike + 3 * (count - alike), density, seed).bits
    first, others = drawn[:alike], drawn[alike:]
    red, green, blue = (
        BitPatterns(shape, np.concatenate([first, others[primary::3]])) for primary in range(3)
    )
    return ColourPatterns(red, green, blue)


def colour_images(stack: NDArray[Any]) -> ColourPatterns:
    """Patterns given as colour images (K, rows, cols, 3) in [0, 1], as bits where they are."""
    parts = []
    for primary in range(3):
        images = ImagePatterns(stack[..., primary])
        bits = images.as_bits()
        parts.append(images if bits is None else BitPatterns(images.shape, bits))
    red, green, blue = parts
    return ColourPatterns(red, green, blue)
