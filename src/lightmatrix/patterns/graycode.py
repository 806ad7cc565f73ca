"""Gray code: black and white stripes that number the projector's columns and rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.stripes import (
    NOTHING,
    StripePatterns,
    Stripes,
    both_axes,
    check_code_shape,
)


@dataclass(frozen=True, eq=False)
class GrayCodePatterns(StripePatterns):
    """Gray code of the columns, then of the rows, then white and black.

    Neighbouring stripes differ in one bit, so that a camera pixel on an edge is off by one stripe
    at most (Inokuchi et al. 1984). The bits come from the coarsest to the finest.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    inverse : bool
        Whether each bit is followed by its inverse. The brighter of the two decides a bit, whatever
        the surface and the global light.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.GrayCodePatterns((4, 8), inverse=True)
    >>> patterns.count, patterns.images()[4, 0].tolist()
    (12, [0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0])
    """

    shape: tuple[int, int]
    inverse: bool = False

    def __post_init__(self) -> None:
        check_code_shape(self.shape)

    @cached_property
    def stripes(self) -> Stripes:
        axes, profiles = [], []
        for axis, length in both_axes(self.shape):
            for bit in with_inverses(gray_bits(np.arange(length)), self.inverse):
                axes.append(axis)
                profiles.append(bit)
        for value in (1, 0):
            axes.append(NOTHING)
            profiles.append(np.full(1, value, np.float32))
        return Stripes(np.array(axes), tuple(profiles))

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "graycode", "shape": list(self.shape), "inverse": self.inverse}


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
