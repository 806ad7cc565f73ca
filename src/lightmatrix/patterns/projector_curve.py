"""The model of a projector's response: the light of each grey value, and the way back.

`capture/camera_curve.py` models the camera's; `calibration/responses/` measures both.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.paths import as_path
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.ranges import as_float, check_number
from lightmatrix.reprs import ShortRepr

# This entry of a capture's description holds the response of its projector.
CURVE = "projector_response"
# The grey value of white.
_WHITE = 255
# Steps of the table of grey values, in the square root of light: with a gamma from 1 to 2.2 it
# misses exact grey values by 0.01 levels before these are rounded.
_STEPS = 65535


@dataclass(frozen=True, repr=False)
class ProjectorResponse(ShortRepr):
    """The projector's response: the light of each grey value.

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
    ) -> "ProjectorResponse":
        """The response from the light that was measured at each grey value.

        Parameters
        ----------
        levels : sequence of int
            Grey values, increasing from 0 (black) to 255 (white).
        light : sequence of float
            Light in any unit, constant ambient light included.
        """
        grey, share = np.asarray(levels), np.asarray(light, np.float64)
        share = (share - share[0]) / (share[-1] - share[0])
        share = np.maximum.accumulate(np.clip(share, 0, 1))
        # Grey values darker than this share of white do not count for the exponent, since noise is
        # a large part of their light. Chosen by hand.
        used = (share > 0.02) & (share < 1)
        log_light, log_grey = np.log(share[used]), np.log(grey[used] / _WHITE)
        gamma = 1.0
        if used.any():
            slope = (log_light @ log_grey) / (log_grey @ log_grey)
            gamma = float(np.clip(slope, 0.1, 10))
        return cls(tuple(map(int, grey)), tuple(map(float, share)), gamma)

    @classmethod
    def of_gamma(cls, gamma: float) -> "ProjectorResponse":
        """The response of a projector whose light is the grey value to the power `gamma`."""
        levels = np.arange(_WHITE + 1)
        return cls(tuple(map(int, levels)), tuple(map(float, (levels / _WHITE) ** gamma)), gamma)

    @classmethod
    def parse(cls, text: str | Path) -> "ProjectorResponse":
        """Read a response: ``linear``, ``gamma:2.2``, or the file that `save` wrote.

        Raises
        ------
        InputError
            On a gamma out of 0.1 to 10, or a file that is missing, damaged, or something else.
        """
        kind, _, gamma = str(text).partition(":")
        hint = "give gamma:2.2, linear, or a file of `lightmatrix response --projector`"
        power = 1.0 if str(text) == "linear" else as_float(gamma) if kind == "gamma" else math.nan
        if not math.isnan(power):
            check_number("a gamma", power, least=0.1, most=10, hint="use 0.1 to 10, such as 2.2")
            return cls.of_gamma(power)
        if as_path(text).is_file():
            return cls.load(text)
        raise InputError(f"{text}: no such file, and no projector's response", hint=hint)

    @classmethod
    def of_provenance(cls, provenance: Mapping[str, Any]) -> "ProjectorResponse | None":
        """The response by which the patterns of an estimate became light; None if by none."""
        description, found = (provenance.get(k) for k in ("capture_description", "found_response"))
        if isinstance(found, Mapping) and "projector_gamma" in found:
            return cls.of_gamma(found["projector_gamma"])
        curve = description.get(CURVE) if isinstance(description, Mapping) else None
        return cls.of_light(**curve) if isinstance(curve, Mapping) else None

    @property
    def as_provenance(self) -> dict[str, Any]:
        """What `of_provenance` reads in the description of a capture, JSON-ready."""
        return {CURVE: {"levels": list(self.levels), "light": list(self.light)}}

    def grey_for(self, light: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Grey values (uint8) that give the wanted light, in [0, 1]."""
        place = np.sqrt(np.clip(light, 0, 1)) * np.float32(_STEPS) + np.float32(0.5)
        return self._greys.take(place.astype(np.uint16))

    @cached_property
    def _greys(self) -> NDArray[np.uint8]:
        """The grey values for light whose square roots are equal steps from 0 to 1."""
        root = (np.arange(_STEPS + 1) / _STEPS) ** (2 / self.gamma)
        return np.rint(np.interp(root, self._root, self.levels)).astype(np.uint8)

    def encoded(self, light: NDArray[np.floating]) -> NDArray[np.float32]:
        """Grey values as a share of white, in 255 steps, that give the wanted light."""
        return np.asarray(self.grey_for(light) / np.float32(_WHITE), np.float32)

    def light_of(self, grey: NDArray[np.floating]) -> NDArray[np.float32]:
        """Light, in [0, 1], of grey values given as a share of white."""
        levels = np.asarray(self.levels, np.float64) / _WHITE
        root = np.interp(np.asarray(grey, np.float64), levels, self._root)
        return (root**self.gamma).astype(np.float32)

    def light_of_patterns(self, patterns: PatternSet) -> PatternSet:
        """The light of patterns that the projector was sent as grey values.

        Black and white patterns do not change. The primaries of colours share the curve.
        """
        if patterns.as_bits() is not None:
            return patterns
        if isinstance(patterns, ColourPatterns):
            red, green, blue = map(self.light_of_patterns, patterns.primaries)
            return ColourPatterns(red, green, blue)
        return ImagePatterns(self.light_of(patterns.images()))

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the response as JSON.

        Raises
        ------
        OutputError
            If the file exists, unless it is a response and `overwrite` is set; or the disk fails.
        """
        levels, light = np.asarray(self.levels, np.float64), np.asarray(self.light)
        curve = CurveFile("projector", levels, light, {"gamma": self.gamma})
        curve.save(path, overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> "ProjectorResponse":
        """Read what `save` wrote.

        Raises
        ------
        InputError
            On a file that is missing, damaged, or something else.
        """
        curve = CurveFile.load(path, "projector")
        return cls.of_light(np.rint(curve.levels).astype(int), curve.light)

    @property
    def _root(self) -> NDArray[np.float64]:
        """The light of `levels` to the power 1 / gamma, which is nearly straight between them."""
        return np.asarray(self.light) ** (1 / self.gamma)
