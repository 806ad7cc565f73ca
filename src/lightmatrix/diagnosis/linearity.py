"""Whether photographs are linear in light.

Light adds up, so what a camera pixel shows under several projector pixels is the sum of what it
shows under each, and can be predicted from its other frames. Photographs that were coded for a
display (sRGB, a gamma of 2.2) do not add up; decoded by the gamma that they were coded with, they
are predicted better. Any gamma makes the predictions of linear photographs worse.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.prediction import FramePrediction, predict
from lightmatrix.diagnosis.survey import Survey

# Three gammas are tried first; then, in the direction that helps, the others.
_FIRST = (1.5, 2.2, 0.65)
_ABOVE, _BELOW = (1.2, 1.5, 1.8, 2.2, 2.6, 3.0), (0.8, 0.65, 0.5, 0.4)
# Rows must be predicted better by 0.04 (mean logarithm of the miss) and by 5 standard errors; below
# a gamma of 1 by 0.15, because noise that grows with the light looks a little like a power.
# Chosen on simulated captures: `python -m benchmarks.frame_checks`.
_BETTER, _BETTER_BELOW, _CERTAIN = 0.04, 0.15, 5.0
# Cameras called linear are so within a few per cent: gammas from 1 / 1.15 to 1.15 are no finding.
_NEARLY_LINEAR = 1.15
# 20 to 400 rows decide, none of which clips in more than 30 % of the frames.
_ROWS, _FEWEST_ROWS = 400, 20
_MOST_CLIPPED = 0.3


def _medium_rows(survey: Survey, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of medium levels that vary as much as `rows`; those that never clip may all be dim."""
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.clipped <= _MOST_CLIPPED)
    usable &= known.spread >= float(np.min(known.spread[rows]))
    return np.sort(np.random.default_rng(1).permutation(np.flatnonzero(usable))[:_ROWS])


def check_linearity(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], *, steady: bool
) -> list[Finding]:
    """Whether the samples, decoded as the capture says, are linear in light.

    `rows` are high-variance rows, and nothing is learned from `doubted` frames (K,). Gammas below
    1 are not tried if the light is not `steady`: its changes look like one.
    """
    rows = _medium_rows(survey, rows)[: max(len(rows), _FEWEST_ROWS)]
    linear = _predict(survey, rows, doubted, 1.0, None)
    if linear.predicted.sum() < _FEWEST_ROWS:
        return []
    rows, linear = rows[linear.predicted], linear.rows(linear.predicted)

    def gain(gamma: float) -> tuple[float, bool]:
        """By how much rows are predicted better, and whether that is certain."""
        other = _predict(survey, rows, doubted, gamma, linear.places)
        better = np.log(linear.miss / np.maximum(other.miss, 1e-12))
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
    likeliest = _likeliest({1.0: 0.0, **gains})
    if 1 / _NEARLY_LINEAR < likeliest < _NEARLY_LINEAR:
        return []
    return [_finding(likeliest, survey.decoder.response.name)]


def _finding(gamma: float, stated: str) -> Finding:
    if gamma < 1:
        return Finding(
            "response",
            (),
            f"the photographs are not linear in light, decoded as {stated}: they look as if raised "
            f"to a power of {1 / gamma:.1f}",
            "give --response linear if they are linear as they are, or measure the camera's curve",
        )
    likely = "srgb or gamma:2.2" if 1.8 < gamma < 2.6 else f"gamma:{gamma:.1f}"
    return Finding(
        "response",
        (),
        f"the photographs are not linear in light, decoded as {stated}: light adds up in them as "
        f"if they were coded with a gamma of about {gamma:.1f}",
        "turn gamma, sRGB, contrast and tone curves off in the camera, or give --response "
        + likely,
    )


def _predict(
    survey: Survey,
    rows: NDArray[np.int64],
    doubted: NDArray[np.bool_],
    gamma: float,
    places: tuple[NDArray[np.int64], ...] | None,
) -> FramePrediction:
    response = survey.decoder.response
    if gamma != 1:
        levels = np.linspace(0, 1, 1024)
        response = Response(levels, response.linearise(levels) ** gamma, "tried")
    return predict(survey.patterns, survey.samples(rows, response), places, doubted)


def _likeliest(gains: dict[float, float]) -> float:
    """The gamma of the largest gain, by a parabola through the three around it."""
    gammas = np.log(sorted(gains))
    heights = np.array([gains[gamma] for gamma in sorted(gains)])
    k = int(heights.argmax())
    if not 0 < k < len(gammas) - 1:
        return float(np.exp(gammas[k]))
    square, slope, _ = np.polyfit(gammas[k - 1 : k + 2] - gammas[k], heights[k - 1 : k + 2], 2)
    return float(np.exp(gammas[k] - slope / (2 * square)))
