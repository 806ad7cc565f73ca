"""Whether photographs are linear in light, and random grey patterns proportional to it.

Light adds up, so what a camera pixel shows under several projector pixels is the sum of what it
shows under each, and can be predicted from its other frames. Photographs that were coded for a
display (sRGB, a gamma of 2.2) do not add up, nor do grey values that a projector's curve bends.
Either curve alone may explain what does not add up, or both: the gamma of each is looked for under
the other's stated response; the one that predicts more of the photographs is taken, and the other
one is looked for again under it.

No estimate of T is needed: `prediction.py` predicts each sample from the other frames of its row.
Where the light of a row is sharp, this finds a gamma to about 0.3 %; where it is blurred, to a few
per cent. `lm.find_response` finds the curve itself, with the help of an estimate of T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response
from lightmatrix.check.bends import (
    FEWEST_ROWS,
    MOST_CLIPPED,
    VARIED,
    Bends,
    Rows,
    explaining_weights,
    light_of,
    solve_bends,
)
from lightmatrix.check.curves import GAMMAS, GammaBend, bent_light, raised
from lightmatrix.check.finding import Finding
from lightmatrix.check.prediction import FramePrediction, mean_around, predict, window_around
from lightmatrix.check.survey import Survey
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Limits:
    """When a power of the light is announced, and how it is searched for.

    Chosen on captures with and without curves (`benchmarks/synthetic_captures.py`,
    `benchmarks/frame_checks.py`), but where another measurement is named.
    """

    # A power is announced if it differs from 1 by this and by `certain` standard errors more: where
    # light is blurred, predictions from windows are off by up to two of them.
    announced: float = 0.02
    certain: float = 4.0
    # Under 16 patterns, windows of 50 pixels explain anything: powers of linear captures were off
    # by up to 0.1 under sharp light and 0.5 under broad light. The logarithm of a power gets a
    # margin of `off_by` at 16 patterns, which falls with the cube of their number. Less the 7
    # columns that are removed, a row has `few_left` samples left under 16 patterns. Rows that have
    # as few left, as where many samples clip, get the same margin, which falls likewise: under 32
    # patterns with 7 samples left, powers of linear captures were off by up to 0.24.
    few_patterns: int = 16
    few_left: float = 9.0
    off_by: float = 0.4
    # Predictions may miss more than this share of the variance under every power. What they miss
    # can then look like a bend, so the power must explain a tenth of it.
    much: float = 0.1
    remains: float = 0.9
    # At most so many rows are predicted, and of more than 64 frames fewer, so that samples are as
    # many (but 200 rows); that takes half a second.
    rows: int = 800
    # Light that reaches far bends predictions as a curve does where patterns are coarse. Under 20
    # patterns and more, what Gaussians of these standard deviations (in pixels) see around the
    # place is removed too.
    enough_patterns: int = 20
    around: tuple[int, ...] = (2, 4, 8, 16)
    # Rows that are predicted badly bias the power, by as much as they miss, and tell little of it.
    # Each row counts by the inverse of the variance that it misses, to which this share of the
    # median is added: a few rows that miss nothing by chance must not decide. Under fewer than 20
    # patterns rows count alike: their variances are not known well, and broad light is missed, not
    # noise.
    missed_anyway: float = 0.3
    # The search for a gamma ends after so many steps, or when a step is smaller than `small`. A
    # step changes the logarithm of the gamma by at most `largest_step`. Where the equation hardly
    # depends on the gamma, secants lead astray; the step is then the bend itself.
    steps: int = 7
    small: float = 0.002
    largest_step: float = 0.5
    flattest: float = 0.2
    # The bend is about the logarithm of the power that is missing. Rows follow the same places
    # under powers that differ by less than this.
    nearly: float = 0.05
    # Powers at which a search begins, one after the other until one settles: linear, a display's,
    # and its opposite.
    starts: tuple[float, ...] = (1.0, 2.2, 0.5)
    # A search may also settle where nothing can be predicted. Predictions under the right power
    # miss no more than those under the stated response, but for chance; under one that only a
    # search from elsewhere finds, they must miss a tenth less. On a linear capture of 32 faint
    # photographs they missed 0.017 of the variance, and 0.37 under a gamma of 6. Of 16 patterns on
    # five scenes and a gamma of 2.2, such powers missed 0.54 to 0.85 of it, on linear captures 0.93
    # and 1.01. Predictions that miss at most `missed_little` are right in any case: which of two
    # misses is smaller is then a matter of noise.
    missed_more: float = 1.05
    missed_little: float = 0.005


_LIMITS = _Limits()


def check_linearity(survey: Survey, doubted: NDArray[np.bool_], *, steady: bool) -> list[Finding]:
    """Whether the samples, decoded as the capture says, are linear in light.

    Nothing is learned from `doubted` frames (K,). Powers below 1 are not announced if the light is
    not `steady`: its changes look like one.
    """
    found = power_from_windows(survey, doubted)
    if found is None or not is_certain(found, survey.distinct_patterns, steady=steady):
        return []
    return [response_finding(found, survey.decoder.response.name)]


def check_grey_levels(survey: Survey, doubted: NDArray[np.bool_], *, steady: bool) -> list[Finding]:
    """Whether samples are linear in light, and patterns light, as the capture says.

    Nothing is learned from `doubted` frames (K,). `steady` is as in `check_linearity`.
    """
    camera = power_from_windows(survey, doubted)
    projector = gamma_from_windows(survey, doubted)
    of_camera, of_projector = (
        found.missed[1] if found is not None and found.settled else 1.0
        for found in (camera, projector)
    )
    if projector is None or of_camera < of_projector:
        if camera is None or not is_certain(camera, survey.distinct_patterns, steady=steady):
            return []
        response = raised(survey.decoder.response, camera.power)
        read = replace(survey, decoder=replace(survey.decoder, response=response))
        other = gamma_from_windows(read, doubted)
        alone = response_finding(camera, survey.decoder.response.name)
    else:
        if not is_certain(projector, survey.distinct_patterns, steady=True):
            return []
        other = power_from_windows(with_gamma(survey, projector.power), doubted)
        uncertainty = max(2 * projector.error * projector.power, 0.01)
        message = (
            "the patterns' grey values are not proportional to light: the projector seems to have "
            f"a gamma of {projector.power:.2f} +- {uncertainty:.2f}"
        )
        advice = 'use projector_response="auto", or measure its curve'
        alone = Finding("projector", (), message, advice)
    if other is None or not is_certain(other, survey.distinct_patterns, steady=steady):
        return [alone]
    advice = 'use response="auto" and projector_response="auto", which find both gammas at once'
    return [
        Finding("response", (), "the photographs are not linear in light", advice),
        Finding("projector", (), "the patterns' grey values are not proportional to light", advice),
    ]


def is_certain(found: WindowPower, count: int, *, steady: bool) -> bool:
    """Whether a power that was found under `count` distinct patterns certainly differs from 1."""
    if not found.settled:
        return False
    few = max(_LIMITS.few_patterns / count, min(1.0, _LIMITS.few_left / max(found.freedom, 1.0)))
    least = _LIMITS.announced + _LIMITS.certain * found.error + _LIMITS.off_by * few**3
    before, after = found.missed
    if after > _LIMITS.much and after > _LIMITS.remains * before:
        return False
    return bool(abs(np.log(found.power)) >= least and (found.power > 1 or steady))


def response_finding(found: WindowPower, stated: str) -> Finding:
    """The finding of photographs that are not linear, decoded by the `stated` response."""
    power, uncertainty = found.power, max(2 * found.error * found.power, 0.01)
    message = f"the photographs are not linear in light, decoded as {stated}: they look"
    advice = 'use response="auto", which finds the curve; or '
    if power < 1:
        message += f" as if raised to a power of {1 / power:.2f} +- {uncertainty / power**2:.2f}"
        return Finding("response", (), message, advice + "measure it")
    coded = "coded with" if stated == "linear" else "coded with a further"
    message += f" {coded} gamma {power:.2f} +- {uncertainty:.2f}"
    advice += "turn gamma, sRGB, contrast and tone curves off in the camera"
    return Finding("response", (), message, advice)


def show_pictures(patterns: PatternSet) -> bool:
    """Whether neighbouring pixels of grey patterns are alike, as those of photographs are."""
    if patterns.as_bits() is not None or patterns.shape[1] < 2:
        return False
    rows, cols = patterns.shape
    drawn = np.random.default_rng(0).integers(0, rows * (cols - 1), 500)
    left = drawn // (cols - 1) * cols + drawn % (cols - 1)
    one, other = (patterns.columns(pixels).astype(np.float64) for pixels in (left, left + 1))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    both = np.sqrt((one**2).sum() * (other**2).sum())
    # Neighbours in random grey patterns do not correlate, those in photographs by more than 0.9.
    return float((one * other).sum() / max(both, 1e-12)) > 0.5


def with_gamma(survey: Survey, gamma: float) -> Survey:
    """The survey, with the light of its patterns' grey values under a gamma of the projector."""
    light = ProjectorResponse.of_gamma(gamma).light_of_patterns(survey.patterns)
    return replace(survey, patterns=light)


@dataclass(frozen=True)
class WindowPower:
    """The power of the light that was found, its standard error, and whether the search settled.

    `missed` is the share of the samples' variance that predictions miss, under the response that
    the capture states and under the power that was found. `freedom` is how many samples under
    different patterns a row has left, on average, that do not clip and can be distinguished from
    the others, less the columns that are removed from it.
    """

    power: float
    error: float
    settled: bool
    missed: tuple[float, float]
    freedom: float = np.inf

    def right_against(self, linear: WindowPower) -> bool:
        """Whether it may be right, by the search that began at the stated response."""
        share = _LIMITS.missed_more if self is linear else _LIMITS.remains
        most = max(share * linear.missed[0], _LIMITS.missed_little)
        return self.settled and self.missed[1] <= most


@dataclass(frozen=True, eq=False)
class _Bend:
    """The bend under one power: its size and standard error, and how it was found.

    `missed` is the usual share of the variance that is missed, `freedom` as in `WindowPower`;
    `places` are those of `find_places`, and `lit` what explains rows there, (m, K, d).
    """

    size: float
    error: float
    missed: float
    freedom: float
    places: tuple[NDArray[np.int64], ...]
    lit: NDArray[np.float64]


def varied_rows(survey: Survey) -> NDArray[np.int64]:
    """Rows that vary much and clip little, sorted; drawn at random if there are many."""
    most = int(np.clip(64 * _LIMITS.rows // survey.count, 200, _LIMITS.rows))
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.clipped <= MOST_CLIPPED)
    usable &= known.highest > known.lowest
    if not usable.any():
        return np.empty(0, np.int64)
    usable &= known.spread > VARIED * np.quantile(known.spread[usable], 0.9)
    return np.sort(np.random.default_rng(1).permutation(np.flatnonzero(usable))[:most])


def power_from_windows(survey: Survey, doubted: NDArray[np.bool_]) -> WindowPower | None:
    """The power of the light under which it adds up best; None if too few rows can be predicted.

    The light is that of the survey's response. Nothing is learned from `doubted` frames, (K,).
    """
    rows = varied_rows(survey)
    if len(rows) < FEWEST_ROWS:
        return None
    first = _search(survey, rows, doubted, _LIMITS.starts[0])
    if first is None or first.right_against(first):
        return first
    for start in _LIMITS.starts[1:]:
        found = _search(survey, rows, doubted, start)
        if found is not None and found.right_against(first):
            return replace(found, missed=(first.missed[0], found.missed[1]))
    return replace(first, settled=False)


def _search(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], start: float
) -> WindowPower | None:
    """The power that a search from one start finds; None if too few rows can be predicted."""
    logs, bends = [float(np.log(start))], list[_Bend]()
    while True:
        response = raised(survey.decoder.response, float(np.exp(logs[-1])))
        # The places that rows follow are looked for until the power is nearly right.
        found = len(bends) > 1 or (len(bends) == 1 and abs(bends[0].size) < _LIMITS.nearly)
        bend = _bend(survey, rows, doubted, response, bends[-1] if found else None)
        if bend is None:
            return None
        bends.append(bend)
        if abs(bend.size) < _LIMITS.small or len(bends) == _LIMITS.steps:
            break
        step = bend.size
        # The secant through the last two bends gives the next power.
        if len(bends) > 1 and logs[-1] != logs[-2]:
            slope = (bend.size - bends[-2].size) / (logs[-1] - logs[-2])
            if slope < -_LIMITS.flattest:
                step = -bend.size / slope
        step = float(np.clip(step, -_LIMITS.largest_step, _LIMITS.largest_step))
        logs.append(float(np.clip(logs[-1] + step, *np.log(GAMMAS))))
    return WindowPower(
        float(np.exp(logs[-1])),
        bend.error,
        settled=abs(bend.size) < 5 * _LIMITS.small,
        missed=(bends[0].missed, bend.missed),
        freedom=bend.freedom,
    )


def _bend(
    survey: Survey,
    rows: NDArray[np.int64],
    doubted: NDArray[np.bool_],
    response: Response,
    known: _Bend | None,
) -> _Bend | None:
    """The bend of one gamma under a response, at the places of a `known` one if there is one.

    None if too few rows can be predicted.
    """
    patterns, decoder = survey.patterns, survey.decoder
    samples = survey.samples(rows, response)
    prediction = predict(patterns, samples, None if known is None else known.places, doubted)
    kept = prediction.predicted
    if kept.sum() < FEWEST_ROWS:
        return None
    decoder = replace(decoder, response=response)
    exposures = np.broadcast_to(np.asarray(decoder.exposure, np.float64), (survey.count,))
    light, dark = light_of(prediction.observed, samples, decoder, exposures)
    expected, _ = light_of(prediction.expected, samples, decoder, exposures)
    if known is None:
        place = prediction.places[0]
        shown = patterns.at(cross(place, patterns.shape)).astype(np.float64)
        columns = [np.moveaxis(shown, 0, 1)]
        if survey.distinct_patterns >= _LIMITS.enough_patterns:
            for spread in _LIMITS.around:
                window = window_around(place, patterns.shape, 2 * spread, spread, spread // 2)
                columns.append(mean_around(patterns, *window)[..., None])
    lit = np.concatenate(columns, axis=2) if known is None else known.lit
    own = [np.ones((*light.shape, 1)), prediction.expected[..., None], lit]
    whole = Rows(
        light,
        expected,
        dark,
        prediction.trusted & ~doubted,
        np.concatenate(own, axis=2) * exposures[None, :, None],
        prediction.part,
    ).select(kept)
    weight = None
    if survey.distinct_patterns >= _LIMITS.enough_patterns:
        # The inverse of the mean square that predictions miss.
        missed = (whole.usable * (whole.light - whole.predicted) ** 2).sum(axis=1)
        missed = missed / np.maximum(whole.usable.sum(axis=1), 1)
        weight = 1 / np.maximum(missed + _LIMITS.missed_anyway * np.median(missed), 1e-18)
    bends = solve_bends(replace(whole, weight=weight), response, GammaBend())
    if bends is None:
        return None
    compared = float(whole.usable.mean()) * survey.distinct_patterns
    return _Bend(
        size=float(bends.sizes[0]),
        error=float(bends.errors[0]),
        missed=float(np.median(prediction.miss)),
        freedom=compared - whole.columns.shape[2],
        places=prediction.places,
        lit=lit,
    )


def cross(places: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    """The pixels at some places and beside them, (m, 5), within the projector."""
    row, col = np.divmod(places, shape[1])
    pixels = [
        np.clip(row + down, 0, shape[0] - 1) * shape[1] + np.clip(col + right, 0, shape[1] - 1)
        for down, right in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
    ]
    return np.stack(pixels, axis=1)


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
        found = _gamma_bend(lit, rows, prediction, doubted)
        if found is None:
            return None
        misses.append(float(np.median(prediction.miss)))
        size = float(found.sizes[-1])
        # Five to eight steps lead from 1 to 2.2.
        if abs(size) < _LIMITS.small or len(misses) == 8:
            break
        gamma = float(np.clip(gamma * (1 + np.clip(size, -0.4, 0.4)), *GAMMAS))
    settled = abs(size) < 5 * _LIMITS.small
    return WindowPower(gamma, float(found.errors[-1]), settled, (misses[0], misses[-1]))


def both_from_windows(survey: Survey, doubted: NDArray[np.bool_]) -> tuple[Response, float]:
    """Nearly the camera's response and the projector's gamma: each is found under the other, twice.

    What cannot be predicted stays as the survey states it. Only an estimate of T tells both well.
    """
    gamma, greys = 1.0, survey
    for _ in range(2):
        found = gamma_from_windows(greys, doubted, gamma)
        gamma = gamma if found is None else found.power
        power = power_from_windows(with_gamma(greys, gamma), doubted)
        if power is not None:
            response = raised(greys.decoder.response, power.power)
            greys = replace(greys, decoder=replace(greys.decoder, response=response))
    return greys.decoder.response, gamma


def _gamma_bend(
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
    chunks = (bent_light(chunk.astype(np.float64)) for _, chunk in patterns.chunks())
    change = weights[:, 1:2] * np.concatenate([bent.mean(axis=1) for bent in chunks])
    change += np.einsum("mkd,md->mk", bent_light(lit), weights[:, 2:])
    part = prediction.part
    whole = Rows(light, expected, dark, usable, columns * unit[..., None], part, change * unit)
    return solve_bends(whole.select(prediction.predicted), decoder.response, None)
