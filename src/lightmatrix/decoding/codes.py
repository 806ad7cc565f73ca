"""Which code the patterns show, read from the patterns themselves, in whatever order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import COLUMNS, NOTHING, ROWS, Stripes, stripes_of

# Grey values that differ by less than one level of 8 bits are the same.
_LEVEL = 1 / 255
_AXIS_NAMES = {COLUMNS: "columns", ROWS: "rows"}


@dataclass(frozen=True, eq=False)
class Code:
    """The values that number the projector's pixels along one axis.

    Parameters
    ----------
    axis : COLUMNS or ROWS
        What the code numbers.
    frames : (k,) int
        The patterns of the code; of a code without inverses, white and black too.
    values : (length, k) float32
        The value of each projector pixel in each of these patterns.
    bits : tuple of (int, int)
        The patterns of each bit and of its inverse, as indices into `frames`; -1 where there is no
        inverse. Empty if some value is grey.
    """

    axis: int
    frames: NDArray[np.int64]
    values: NDArray[np.float32]
    bits: tuple[tuple[int, int], ...]

    @property
    def length(self) -> int:
        """Number of projector pixels along the axis."""
        return len(self.values)

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

    Raises
    ------
    InputError
        If a pattern varies along both rows and columns, or if the patterns of an axis show two of
        its pixels alike.
    """
    stripes = stripes_of(patterns)
    if stripes is None:
        raise InputError(
            "these patterns are no stripes: one varies along both rows and columns",
            hint="estimate T from them: lightmatrix estimate",
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
        raise InputError("no pattern varies", hint="project a code: lightmatrix patterns graycode")
    return Codes(found, white, black)


def _code(stripes: Stripes, axis: int, length: int, ends: list[tuple[int, int]]) -> Code:
    """The code of an axis; `ends` are the white and the black pattern, as far as there are any."""
    frames = np.flatnonzero(stripes.axes == axis)
    values = np.stack([stripes.profiles[k] for k in frames], axis=1)
    distinct = len(np.unique(np.rint(values / _LEVEL), axis=0))
    if distinct < length:
        raise InputError(
            f"the {len(frames)} patterns along {_AXIS_NAMES[axis]} tell only {distinct} of "
            f"{length} {_AXIS_NAMES[axis]} apart",
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
