"""Whether photographs are linear in light.

Light adds up, so what a camera pixel shows under several projector pixels is the sum of what it
shows under each, and can be predicted from its other frames. Photographs that were coded for a
display (sRGB, a gamma of 2.2) do not add up; decoded by the gamma that they were coded with, they
are predicted better. Linear ones are predicted worse by any gamma.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.local import Prediction, predict
from lightmatrix.diagnosis.survey import Survey

# Tried first; then, in the direction that helps, the others.
_FIRST = (1.5, 2.2, 0.65)
_ABOVE, _BELOW = (1.2, 1.5, 1.8, 2.2, 2.6, 3.0), (0.8, 0.65, 0.5, 0.4)
# By how much rows must be predicted better (mean logarithm of the miss), and in standard errors.
# Noise that grows with the light looks a little like a power, so more is asked for below 1.
_BETTER, _BETTER_BELOW, _CERTAIN = 0.04, 0.15, 5.0
# Cameras called linear are so within a few per cent.
_NEAR = 1.15
_ROWS, _FEWEST_ROWS = 400, 20
# Frames are told apart well enough by so many; more only take longer.
_MOST_CLIPPED = 0.3


def response_rows(survey: Survey, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of medium levels: among those that never clip only dim ones may be left.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Lively rows, whose spread is asked for.
    """
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.clipped <= _MOST_CLIPPED)
    usable &= known.spread >= float(np.min(known.spread[rows]))
    found = np.random.default_rng(1).permutation(np.flatnonzero(usable))[:_ROWS]
    return np.sort(found)


def check_response(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], *, steady: bool
) -> list[Finding]:
    """Whether the samples, as the capture says they are decoded, are linear in light.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Lively rows.
    doubted : (K,) bool
        Frames that are odd by themselves; nothing is learned from them.
    steady : bool
        Whether the light is the same in all frames; its changes look like a power below 1.
    """
    rows = response_rows(survey, rows)[: max(len(rows), _FEWEST_ROWS)]
    straight = _predicted(survey, rows, doubted, 1.0, None)
    told = straight.predicted
    if told.sum() < _FEWEST_ROWS:
        return []
    rows, straight = rows[told], straight.rows(told)

    def gain(gamma: float) -> tuple[float, bool]:
        """By how much rows are predicted better, and whether that is certain."""
        bent = _predicted(survey, rows, doubted, gamma, straight.places)
        better = np.log(straight.miss / np.maximum(bent.miss, 1e-12))
        error = float(better.std() / np.sqrt(len(better)))
        least = _BETTER if gamma > 1 else _BETTER_BELOW
        size = float(better.mean())
        return size, size > max(least, _CERTAIN * error)

    tried = {gamma: gain(gamma) for gamma in _FIRST if gamma > 1 or steady}
    helping = [gamma for gamma, (_, certain) in tried.items() if certain]
    if not helping:
        return []
    best = max(helping, key=lambda gamma: tried[gamma])
    side = _ABOVE if best > 1 else _BELOW
    gains = {gamma: (tried.get(gamma) or gain(gamma))[0] for gamma in side}
    found = _top({1.0: 0.0, **gains})
    if 1 / _NEAR < found < _NEAR:
        return []
    return [_say(found, survey.decoder.response.name)]


def _say(gamma: float, stated: str) -> Finding:
    if gamma < 1:
        return Finding(
            "response",
            (),
            f"the photographs are not linear in light, decoded as {stated}: they look as if raised "
            f"to a power of {1 / gamma:.1f}",
            "say --response linear if they are linear as they are, or measure the camera's curve",
        )
    likely = "srgb or gamma:2.2" if 1.8 < gamma < 2.6 else f"gamma:{gamma:.1f}"
    return Finding(
        "response",
        (),
        f"the photographs are not linear in light, decoded as {stated}: light adds up in them as "
        f"if they were coded with a gamma of about {gamma:.1f}",
        "turn gamma, sRGB, contrast and tone curves off in the camera, or say --response " + likely,
    )


def _predicted(
    survey: Survey,
    rows: NDArray[np.int64],
    doubted: NDArray[np.bool_],
    gamma: float,
    places: tuple[NDArray[np.int64], ...] | None,
) -> Prediction:
    response = survey.decoder.response
    if gamma != 1:
        levels = np.linspace(0, 1, 1024)
        response = Response(levels, response.linearise(levels) ** gamma, "tried")
    return predict(survey.patterns, survey.samples(rows, response), places, doubted)


def _top(gains: dict[float, float]) -> float:
    """The gamma of the largest gain, between the ones that were tried by a parabola."""
    gammas = np.log(sorted(gains))
    heights = np.array([gains[gamma] for gamma in sorted(gains)])
    k = int(heights.argmax())
    if not 0 < k < len(gammas) - 1:
        return float(np.exp(gammas[k]))
    square, slope, _ = np.polyfit(gammas[k - 1 : k + 2] - gammas[k], heights[k - 1 : k + 2], 2)
    return float(np.exp(gammas[k] - slope / (2 * square)))
