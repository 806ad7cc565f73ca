"""The projector's gamma under random grey patterns, by windows of pixels, without an estimate of T.

Each row is explained by the light of the pixel that it follows most and of its four neighbours, and
by the mean of the pattern. How this light changes with the gamma is the bend for which `trace.py`
solves, as `from_greys.py` does with an estimate of T. The camera's response is taken as known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.diagnosis.prediction import FramePrediction, predict
from lightmatrix.diagnosis.responses.bend import raised
from lightmatrix.diagnosis.responses.from_greys import GAMMAS, bent_light, explaining_weights
from lightmatrix.diagnosis.responses.from_windows import (
    FEWEST_ROWS,
    SMALL,
    WindowPower,
    cross,
    power_from_windows,
    varied_rows,
)
from lightmatrix.diagnosis.responses.trace import Bends, Rows, light_of, solve_bends
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse

Array = NDArray[np.float64]

# A step changes the gamma by at most 40 %; five to eight steps lead from 1 to 2.2.
_LARGEST_STEP, _STEPS = 0.4, 8
# Both responses are looked for in turn, twice each; then an estimate of T tells more.
_ROUNDS = 2
# Grey patterns are pictures if pixels beside each other correlate by more than 0.5, in 500 pairs.
# Random grey patterns do not correlate, photographs by more than 0.9.
_ALIKE, _PAIRS = 0.5, 500


def show_pictures(patterns: PatternSet) -> bool:
    """Whether neighbouring pixels of grey patterns are alike, as those of photographs are."""
    if patterns.as_bits() is not None or patterns.shape[1] < 2:
        return False
    rows, cols = patterns.shape
    drawn = np.random.default_rng(0).integers(0, rows * (cols - 1), _PAIRS)
    left = drawn // (cols - 1) * cols + drawn % (cols - 1)
    one, other = (patterns.columns(pixels).astype(np.float64) for pixels in (left, left + 1))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    both = np.sqrt((one**2).sum() * (other**2).sum())
    return float((one * other).sum() / max(both, 1e-12)) > _ALIKE


def with_gamma(survey: Survey, gamma: float) -> Survey:
    """The survey, with the light of its patterns' grey values under a gamma of the projector."""
    light = ProjectorResponse.of_gamma(gamma).light_of_patterns(survey.patterns)
    return replace(survey, patterns=light)


def gamma_from_windows(
    survey: Survey, doubted: NDArray[np.bool_], start: float = 1.0
) -> WindowPower | None:
    """The projector's gamma under which light adds up best; None if too few rows can be predicted.

    The survey's patterns are grey values. Nothing is learned from `doubted` frames, (K,).
    """
    rows = varied_rows(survey)
    if len(rows) < FEWEST_ROWS:
        return None
    gamma, misses = start, list[float]()
    while True:
        lit = with_gamma(survey, gamma)
        prediction = predict(lit.patterns, lit.samples(rows), doubted=doubted)
        if prediction.predicted.sum() < FEWEST_ROWS:
            return None
        found = _bend(lit, rows, prediction, doubted)
        if found is None:
            return None
        misses.append(float(np.median(prediction.miss)))
        size = float(found.sizes[-1])
        if abs(size) < SMALL or len(misses) == _STEPS:
            break
        step = float(np.clip(size, -_LARGEST_STEP, _LARGEST_STEP))
        gamma = float(np.clip(gamma * (1 + step), *GAMMAS))
    settled = abs(size) < 5 * SMALL
    return WindowPower(gamma, float(found.errors[-1]), settled, (misses[0], misses[-1]))


def both_from_windows(survey: Survey, doubted: NDArray[np.bool_]) -> tuple[Response, float]:
    """Nearly the camera's response and the projector's gamma: each is found under the other, twice.

    What cannot be predicted stays as the survey states it. Only an estimate of T tells both well.
    """
    gamma, greys = 1.0, survey
    for _ in range(_ROUNDS):
        found = gamma_from_windows(greys, doubted, gamma)
        gamma = gamma if found is None else found.power
        power = power_from_windows(with_gamma(greys, gamma), doubted)
        if power is not None:
            response = raised(greys.decoder.response, power.power)
            greys = replace(greys, decoder=replace(greys.decoder, response=response))
    return greys.decoder.response, gamma


def _bend(
    survey: Survey,
    rows: NDArray[np.int64],
    prediction: FramePrediction,
    doubted: NDArray[np.bool_],
) -> Bends | None:
    """How much the projector's gamma is off, as a share of it."""
    patterns, decoder = survey.patterns, survey.decoder
    samples = survey.samples(rows)
    exposures = np.broadcast_to(np.asarray(decoder.exposure, np.float64), (survey.count,))
    light, dark = light_of(prediction.observed, samples, decoder, exposures)
    expected, _ = light_of(prediction.expected, samples, decoder, exposures)
    unit = light_of(np.ones_like(light), samples, decoder, exposures)[0] - dark
    usable = prediction.trusted & ~doubted
    pixels = cross(prediction.places[0], patterns.shape)
    lit = np.moveaxis(patterns.at(pixels), 0, 1).astype(np.float64)
    even = np.ones((*light.shape, 1))
    mean = np.broadcast_to(patterns.means[None, :, None], even.shape)
    columns = np.concatenate([even, mean, lit], axis=2)
    weights = explaining_weights(columns, samples, usable)
    change = weights[:, 1:2] * _mean_bend(patterns)
    change += np.einsum("mkd,md->mk", bent_light(lit), weights[:, 2:])
    part = prediction.part
    whole = Rows(light, expected, dark, usable, columns * unit[..., None], part, change * unit)
    return solve_bends(whole.select(prediction.predicted), decoder.response, None)


def _mean_bend(patterns: PatternSet) -> Array:
    """The mean of `bent_light` over the pixels of each pattern, (K,)."""
    means = [bent_light(chunk.astype(np.float64)).mean(axis=1) for _, chunk in patterns.chunks()]
    return np.concatenate(means)
