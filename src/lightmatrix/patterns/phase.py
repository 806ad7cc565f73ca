"""Phase shifts: sinusoids in several shifts, and Gray code that tells their periods apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.graycode import gray_bits, with_inverses
from lightmatrix.patterns.stripes import StripePatterns, Stripes, both_axes, check_code_shape

# Projector pixels of a period where none is asked for. Chosen by hand: short periods place a pixel
# more finely, but a projector out of focus by a pixel leaves a quarter less of 8 pixels' contrast.
USUAL_PERIOD = 8.0
# Shifts of the sinusoid, by a quarter of its period.
SHIFTS = 4


@dataclass(frozen=True, eq=False)
class PhasePatterns(StripePatterns):
    """Gray code down to half periods, and four shifts of a sinusoid, of columns, then of rows.

    The sinusoid places a camera pixel to fractions of a projector pixel within its period; the code
    says which period it is (Sansoni et al. 1999). Its stripes are half a period wide, so that an
    edge between them never lies where the phase starts anew.

    Parameters
    ----------
    shape : (int, int)
        Projector rows and columns.
    period : float
        Projector pixels of a period, at least 3.
    inverse : bool
        Whether each bit of the Gray code is followed by its inverse.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.PhasePatterns((16, 32), inverse=True).count
    18
    """

    shape: tuple[int, int]
    period: float = USUAL_PERIOD
    inverse: bool = False

    def __post_init__(self) -> None:
        check_code_shape(self.shape)
        check_period(self.period)

    @cached_property
    def stripes(self) -> Stripes:
        axes, profiles = [], []
        for axis, length in both_axes(self.shape):
            pixel = np.arange(length)
            half = (2 * pixel / self.period).astype(np.int64)
            bits = gray_bits(half)
            shifts = np.arange(SHIFTS) / SHIFTS
            waves = sinusoid(pixel[None, :] / self.period - shifts[:, None])
            for profile in (*with_inverses(bits, self.inverse), *waves):
                axes.append(axis)
                profiles.append(profile)
        return Stripes(np.array(axes), tuple(profiles))

    @property
    def description(self) -> dict[str, Any]:
        return {
            "kind": "phase",
            "shape": list(self.shape),
            "period": self.period,
            "inverse": self.inverse,
        }


def sinusoid(phase: NDArray[np.float64]) -> NDArray[np.float32]:
    """Grey values in [0, 1] at phases in periods, as 8 bits can show them."""
    return (np.rint(255 * (0.5 + 0.5 * np.cos(2 * np.pi * phase))) / 255).astype(np.float32)


def check_period(period: float) -> None:
    """Refuse periods that pixels cannot show."""
    if not 3 <= period < np.inf:
        raise InputError(
            f"a period of {period} projector pixels", hint="use at least 3, such as 8 or 16"
        )
