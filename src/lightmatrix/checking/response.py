"""Whether photographs are linear in light.

Light adds up, so a camera pixel under several projector pixels shows the sum of what it shows under
each. Photographs that were coded for a display (sRGB, a gamma of 2.2) show more than that at medium
levels: they lie above the straight line that the predictions follow. The gamma at which they do not
is that of the photographs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.response import Response
from lightmatrix.checking.finding import Finding
from lightmatrix.checking.local import Prediction, predict
from lightmatrix.checking.survey import Survey

_GAMMAS = (0.4, 0.5, 0.65, 0.8, 1.0, 1.25, 1.5, 1.8, 2.2, 2.6, 3.0)
# A bend counts if it is this many times its standard error and this part of the range, and if the
# rows are predicted better without it by this much (logarithm of the miss).
_CERTAIN, _BENT, _BETTER = 5.0, 0.06, 0.1
# Gammas closer to 1 are left alone: cameras called linear are so within a few per cent.
_NEAR = 1.2
_ROWS = 300


@dataclass(frozen=True)
class Bend:
    """How far samples lie above the straight line at medium levels.

    Parameters
    ----------
    size, error : float
        The bend, as a share of a row's range, and its standard error.
    miss : (m,) float64
        What the predictions of each row miss.
    """

    size: float
    error: float
    miss: NDArray[np.float64]

    @property
    def sure(self) -> float:
        """The bend in standard errors."""
        return self.size / max(self.error, 1e-12)


def bend(prediction: Prediction) -> Bend:
    """Measure the bend of predicted rows."""
    expected = np.where(prediction.trusted, prediction.expected, np.nan)
    low, high = np.nanquantile(expected, [0.1, 0.9], axis=1)[:, :, None]
    span = np.maximum(high - low, 1e-9)
    middle = (prediction.expected - low) * (high - prediction.expected) / span**2
    # Far beyond the usual levels one sample would outweigh all others.
    counted = prediction.trusted & (middle > -0.3)
    middle = np.where(counted, middle, 0)
    above = np.where(counted, (prediction.observed - prediction.expected) / span, 0)
    products, squares = (above * middle).sum(axis=1), (middle**2).sum(axis=1)
    total = max(float(squares.sum()), 1e-12)
    size = float(products.sum()) / total
    # Samples of a row share its errors, so rows are counted, not samples.
    error = float(np.sqrt(((products - size * squares) ** 2).sum())) / total
    return Bend(size, error, prediction.miss)


def check_response(
    survey: Survey, rows: NDArray[np.int64], places: tuple[NDArray[np.int64], ...]
) -> list[Finding]:
    """Whether the samples, as the capture says they are decoded, are linear in light.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Rows that can be predicted.
    places : tuple of (m,) int
        Around which projector pixels, see `find_places`.
    """
    rows, places = rows[:_ROWS], tuple(place[:_ROWS] for place in places)

    def at(gamma: float) -> Bend:
        response = _further(survey.decoder.response, gamma)
        found = predict(survey.patterns, survey.samples(rows, response), places)
        return bend(found)

    now = at(1.0)
    if abs(now.size) < _BENT or abs(now.sure) < _CERTAIN:
        return []
    # Samples above the line are of a gamma above 1.
    tried = [gamma for gamma in _GAMMAS if (gamma > 1) == (now.size > 0) and gamma != 1]
    tried.sort(key=lambda gamma: abs(np.log(gamma)))
    before, previous = now, 1.0
    for gamma in tried:
        after = at(gamma)
        if after.size * now.size <= 0:
            share = before.size / (before.size - after.size)
            found = float(np.exp(np.log(previous) + share * np.log(gamma / previous)))
            break
        before, previous = after, gamma
    else:
        found, after = previous, before
    straight = at(found)
    better = float(np.median(np.log(now.miss / np.maximum(straight.miss, 1e-12))))
    if better < _BETTER or 1 / _NEAR < found < _NEAR:
        return []
    stated = survey.decoder.response.name
    if found < 1:
        return [
            Finding(
                "response",
                (),
                f"the photographs are not linear in light once decoded as {stated}: they look as "
                f"if raised to a power of {1 / found:.2g}",
                "say --response linear if they are linear as they are, or measure the camera's "
                "curve",
            )
        ]
    likely = "srgb or gamma:2.2" if 1.9 < found < 2.5 else f"gamma:{found:.2g}"
    return [
        Finding(
            "response",
            (),
            f"the photographs are not linear in light (decoded as {stated}): medium levels are "
            f"too bright, as with a gamma of {found:.2g}",
            f"turn gamma, sRGB and tone curves off in the camera, or say --response {likely}",
        )
    ]


def _further(response: Response, gamma: float) -> Response:
    """A response followed by a power."""
    if gamma == 1:
        return response
    levels = np.linspace(0, 1, 1024)
    return Response(levels, response.linearise(levels) ** gamma, "tried")
