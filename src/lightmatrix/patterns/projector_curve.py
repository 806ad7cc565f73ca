"""The projector's response: the light it gives for each grey value, and the way back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.curves import CurveFile
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

# Of white: darker steps say little of the exponent.
_FAINT = 0.02
_WHITE = 255


@dataclass(frozen=True)
class ProjectorResponse:
    """Light of grey values.

    Parameters
    ----------
    levels : tuple of int
        Grey values, from 0 to 255.
    light : tuple of float
        Light of each, from 0 to 1; never decreasing.
    gamma : float
        The power of the grey value that comes nearest.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> response = lm.ProjectorResponse.of_light([0, 64, 128, 192, 255], [3, 16, 55, 120, 211])
    >>> round(response.gamma), response.grey_for(np.array([0.0, 0.5, 1.0])).tolist()
    (2, [0, 181, 255])
    """

    levels: tuple[int, ...]
    light: tuple[float, ...]
    gamma: float

    @classmethod
    def of_light(
        cls,
        levels: Sequence[int] | NDArray[np.integer],
        light: Sequence[float] | NDArray[np.float64],
    ) -> ProjectorResponse:
        """The response of which so much light was measured at each grey value.

        Parameters
        ----------
        levels : sequence of int
            Grey values, increasing from 0 (black) to 255 (white).
        light : sequence of float
            In any unit, with any constant light besides.
        """
        grey, seen = np.asarray(levels), np.asarray(light, np.float64)
        seen = (seen - seen[0]) / (seen[-1] - seen[0])
        seen = np.maximum.accumulate(np.clip(seen, 0, 1))
        clear = (seen > _FAINT) & (seen < 1)
        bent, value = np.log(seen[clear]), np.log(grey[clear] / _WHITE)
        gamma = float(np.clip((bent @ value) / (value @ value), 0.1, 10)) if clear.any() else 1.0
        return cls(tuple(map(int, grey)), tuple(map(float, seen)), gamma)

    def grey_for(self, light: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Grey values (uint8) that give the wanted light, in [0, 1]."""
        wanted = np.asarray(light, np.float64) ** (1 / self.gamma)
        return np.rint(np.interp(wanted, self._bent, self.levels)).astype(np.uint8)

    def light_of(self, grey: NDArray[np.floating]) -> NDArray[np.float32]:
        """Light, in [0, 1], of grey values given as a share of white."""
        levels = np.asarray(self.levels, np.float64) / _WHITE
        bent = np.interp(np.asarray(grey, np.float64), levels, self._bent)
        return (bent**self.gamma).astype(np.float32)

    def shown(self, patterns: PatternSet) -> PatternSet:
        """The patterns as light, where the projector was given them as grey values.

        Those of black and white alone are what they are.
        """
        if patterns.as_bits() is not None:
            return patterns
        return ImagePatterns(self.light_of(patterns.images()))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write it as JSON.

        Raises
        ------
        OutputError
            If there is a file that is no response or must not be replaced, or the disk fails.
        """
        levels, light = np.asarray(self.levels, np.float64), np.asarray(self.light)
        told = CurveFile("projector", levels, light, {"gamma": self.gamma})
        told.save(path, overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> ProjectorResponse:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            On a file that is missing, damaged, or something else.
        """
        told = CurveFile.load(path, "projector")
        return cls.of_light(np.rint(told.levels).astype(int), told.light)

    @property
    def _bent(self) -> NDArray[np.float64]:
        """The light of `levels` in a measure in which the curve is nearly straight between them."""
        return np.asarray(self.light) ** (1 / self.gamma)
