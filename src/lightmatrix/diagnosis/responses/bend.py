"""How a response curve may differ from the one that is assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response

Light = NDArray[np.float64]

# Light below this share of full light counts as this much; its logarithm must be finite. It is a
# tenth of a step of 16 bits.
_DARKEST = 1e-6
# Gammas of cameras and displays lie well within this range.
GAMMAS = (0.2, 6.0)
# Points of a curve with bends. They are four times as dense as the levels of a camera of 10 bits.
_POINTS = 4097
# Part of a curve's mean slope that remains everywhere, so that the curve increases strictly.
_LEAST_SLOPE = 0.01


@dataclass(frozen=True)
class GammaBend:
    """A change of the exponent: u becomes u^(1 + c), nearly u + c u ln u."""

    count = 1

    def functions(self, light: Light, response: Response) -> Light:
        """The bend u ln u at light u (...), as (1, ...)."""
        return (light * np.log(np.maximum(light, _DARKEST)))[None]

    def bent(self, response: Response, sizes: Light) -> Response:
        """The response with its light raised to the power 1 + c."""
        return raised(response, 1 + float(sizes[0]))


@dataclass(frozen=True)
class SmoothBends:
    """Bends u (1 - v) C_k(2 v - 1) with Chebyshev polynomials C_k of the level v, k < count.

    They vanish at black and at full light. A gamma is nearly the first one.
    """

    count: int = 3

    def functions(self, light: Light, response: Response) -> Light:
        """Each bend at light (...), as (count, ...)."""
        levels, curve = points(response)
        return self._at(np.interp(light, curve, levels), light)

    def bent(self, response: Response, sizes: Light) -> Response:
        """The response with bends of some sizes, kept increasing."""
        levels, light = points(response)
        bent = light + np.tensordot(sizes, self._at(levels, light), axes=1)
        least = _LEAST_SLOPE / (len(levels) - 1)
        rising = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(bent), least))])
        return Response(levels, rising / rising[-1], "curve found in the capture")

    def _at(self, levels: Light, light: Light) -> Light:
        identity = np.eye(self.count)
        shape = light * (1 - levels)
        chebyshev = np.polynomial.chebyshev.chebval
        return np.stack([shape * chebyshev(2 * levels - 1, each) for each in identity])


Bend = GammaBend | SmoothBends


def raised(response: Response, power: float) -> Response:
    """The response with its light raised to a power, which is a gamma if it was one."""
    if response.levels is None or response.name.startswith("gamma:"):
        return gamma_response(exponent(response) * power)
    levels, light = points(response)
    return Response(levels, light**power, f"{response.name}, to the power {power:.3f}")


def gamma_response(gamma: float) -> Response:
    """The response of a gamma; linear for 1."""
    return Response() if gamma == 1 else Response.parse(f"gamma:{np.clip(gamma, *GAMMAS):.4f}")


def exponent(response: Response) -> float:
    """The gamma of a response that is one; otherwise the power that is nearest to its curve."""
    if response.name.startswith("gamma:"):
        return float(response.name.removeprefix("gamma:"))
    if response.levels is None:
        return 1.0
    levels, light = points(response)
    part = (levels > 0.1) & (levels < 0.99) & (light > 0)
    log_level, log_light = np.log(levels[part]), np.log(light[part])
    return float((log_light @ log_level) / (log_level @ log_level))


def points(response: Response) -> tuple[Light, Light]:
    """Levels and light of a curve, both as a share of full scale, at evenly spaced levels."""
    levels = np.linspace(0, 1, _POINTS)
    return levels, response.linearise(levels)
