"""The response by predictions from windows of projector pixels, without an estimate of T.

`diagnosis/prediction.py` predicts each sample from the other frames of its row. Where the light of
a row is sharp, this finds a gamma to about 0.3 %; where it is blurred, to a few per cent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.diagnosis.prediction import mean_around, predict, window_around
from lightmatrix.diagnosis.responses.bend import GammaBend, raised
from lightmatrix.diagnosis.responses.trace import Rows, light_of, solve_bends
from lightmatrix.diagnosis.survey import Survey

# At most so many rows are predicted, and of more than 64 frames fewer, so that samples are as many
# (but 200 rows); that takes half a second. Fewer rows than the last number determine nothing. Rows
# clip in at most 30 % of the frames, and vary by more than 15 % of what the most varied tenth does.
_ROWS, _SAMPLES, _ENOUGH_ROWS, FEWEST_ROWS = 800, 800 * 64, 200, 20
_MOST_CLIPPED, _VARIED = 0.3, 0.15
# The projector pixels that are removed from each row: the one that it follows most, and its four
# neighbours.
_CROSS = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
# Light that reaches far bends predictions as a curve does where patterns are coarse. Under 20
# patterns and more, what Gaussians of these standard deviations (in pixels) see around the place is
# removed too. Chosen on captures with and without curves (`benchmarks/synthetic_captures.py`).
_AROUND = (2, 4, 8, 16)
_ENOUGH_PATTERNS = 20
# Rows that are predicted badly bias the power, by as much as they miss, and tell little of it. Each
# row counts by the inverse of the variance that it misses, to which this share of the median is
# added: a few rows that miss nothing by chance must not decide. Under fewer than 20 patterns rows
# count alike: their variances are not known well, and broad light is missed, not noise. Chosen on
# captures with and without curves (`benchmarks/frame_checks.py`, `synthetic_captures.py` there).
_MISSED_ANYWAY = 0.3
# The search for a gamma ends after so many steps, or when a step is smaller than this.
_STEPS, SMALL = 7, 0.002
# The bend is about the logarithm of the power that is missing. Rows follow the same places under
# powers that differ by less than this. Chosen by hand.
_NEARLY = 0.05
# A step changes the logarithm of the gamma by at most 0.5. Where the equation hardly depends on the
# gamma, secants lead astray; the step is then the bend itself.
_LARGEST_STEP, _FLATTEST = 0.5, 0.2
# Powers at which a search begins, one after the other until one settles: linear, a display's, and
# its opposite.
_STARTS = (1.0, 2.2, 0.5)
# A search may also settle where nothing can be predicted. Predictions under the right power miss no
# more than those under the stated response, but for chance: 5 %. On a linear capture of 32 faint
# photographs they missed 0.017 of the variance, and 0.37 under a gamma of 6. Predictions that miss
# at most 0.5 % are right in any case: which of two misses is smaller is then a matter of noise.
_MISSED_MORE, _MISSED_LITTLE = 1.05, 0.005
# Powers of the light lie well within this range.
_POWERS = (0.2, 6.0)


@dataclass(frozen=True)
class WindowPower:
    """The power of the light that was found, its standard error, and whether the search settled.

    `missed` is the share of the samples' variance that predictions miss, under the response that
    the capture states and under the power that was found. `freedom` is how many samples under
    different patterns a row has left, on average, that do not clip and can be told from the others,
    less the columns that are removed from it.
    """

    power: float
    error: float
    settled: bool
    missed: tuple[float, float]
    freedom: float = np.inf

    def right_against(self, linear: WindowPower) -> bool:
        """Whether it may be right, by the search that began at the stated response."""
        most = max(_MISSED_MORE * linear.missed[0], _MISSED_LITTLE)
        return self.settled and self.missed[1] <= most


@dataclass(frozen=True, eq=False)
class _Places:
    """The projector pixels that rows follow, as `find_places` has them, and the light around them.

    `lit` is what explains rows there, (m, K, d).
    """

    pixels: tuple[NDArray[np.int64], ...]
    lit: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Bend:
    """The bend under one power: its size and standard error, and how it was found.

    `missed` is the usual share of the variance that is missed, `freedom` as in `WindowPower`.
    """

    size: float
    error: float
    missed: float
    freedom: float
    places: _Places


def varied_rows(survey: Survey, most: int | None = None) -> NDArray[np.int64]:
    """Rows that vary much and clip little, sorted; drawn at random if there are many."""
    if most is None:
        most = int(np.clip(_SAMPLES // survey.count, _ENOUGH_ROWS, _ROWS))
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.clipped <= _MOST_CLIPPED)
    usable &= known.highest > known.lowest
    if not usable.any():
        return np.empty(0, np.int64)
    usable &= known.spread > _VARIED * np.quantile(known.spread[usable], 0.9)
    return np.sort(np.random.default_rng(1).permutation(np.flatnonzero(usable))[:most])


def power_from_windows(survey: Survey, doubted: NDArray[np.bool_]) -> WindowPower | None:
    """The power of the light under which it adds up best; None if too few rows can be predicted.

    The light is that of the survey's response. Nothing is learned from `doubted` frames, (K,).
    """
    rows = varied_rows(survey)
    if len(rows) < FEWEST_ROWS:
        return None
    first = _search(survey, rows, doubted, _STARTS[0])
    if first is None or first.right_against(first):
        return first
    for start in _STARTS[1:]:
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
        found = len(bends) > 1 or (len(bends) == 1 and abs(bends[0].size) < _NEARLY)
        bend = _bend(survey, rows, doubted, response, bends[-1].places if found else None)
        if bend is None:
            return None
        bends.append(bend)
        if abs(bend.size) < SMALL or len(bends) == _STEPS:
            break
        step = _step(logs, [each.size for each in bends])
        logs.append(float(np.clip(logs[-1] + step, *np.log(_POWERS))))
    return WindowPower(
        float(np.exp(logs[-1])),
        bend.error,
        settled=abs(bend.size) < 5 * SMALL,
        missed=(bends[0].missed, bend.missed),
        freedom=bend.freedom,
    )


def _step(logs: list[float], sizes: list[float]) -> float:
    """The next change of the logarithm of the gamma, by the secant through the last two."""
    step = sizes[-1]
    if len(sizes) > 1 and logs[-1] != logs[-2]:
        slope = (sizes[-1] - sizes[-2]) / (logs[-1] - logs[-2])
        if slope < -_FLATTEST:
            step = -sizes[-1] / slope
    return float(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))


def _bend(
    survey: Survey,
    rows: NDArray[np.int64],
    doubted: NDArray[np.bool_],
    response: Response,
    places: _Places | None,
) -> _Bend | None:
    """The bend of one gamma under a response.

    The places are those that are given, or are looked for. None if too few rows can be predicted.
    """
    patterns, decoder = survey.patterns, survey.decoder
    samples = survey.samples(rows, response)
    prediction = predict(patterns, samples, None if places is None else places.pixels, doubted)
    kept = prediction.predicted
    if kept.sum() < FEWEST_ROWS:
        return None
    decoder = replace(decoder, response=response)
    exposures = np.broadcast_to(np.asarray(decoder.exposure, np.float64), (survey.count,))
    light, dark = light_of(prediction.observed, samples, decoder, exposures)
    expected, _ = light_of(prediction.expected, samples, decoder, exposures)
    if places is None:
        places = _Places(prediction.places, _lit_around(survey, prediction.places[0]))
    own = [np.ones((*light.shape, 1)), prediction.expected[..., None], places.lit]
    whole = Rows(
        light,
        expected,
        dark,
        prediction.trusted & ~doubted,
        np.concatenate(own, axis=2) * exposures[None, :, None],
        prediction.part,
    ).select(kept)
    weight = _row_weights(whole) if survey.distinct_patterns >= _ENOUGH_PATTERNS else None
    bends = solve_bends(replace(whole, weight=weight), response, GammaBend())
    if bends is None:
        return None
    compared = float(whole.usable.mean()) * survey.distinct_patterns
    return _Bend(
        size=float(bends.sizes[0]),
        error=float(bends.errors[0]),
        missed=float(np.median(prediction.miss)),
        freedom=compared - whole.columns.shape[2],
        places=places,
    )


def _row_weights(rows: Rows) -> NDArray[np.float64]:
    """How much each row counts, (m,): the inverse of the mean square that its predictions miss."""
    missed = (rows.usable * (rows.light - rows.predicted) ** 2).sum(axis=1)
    missed = missed / np.maximum(rows.usable.sum(axis=1), 1)
    return np.asarray(1 / np.maximum(missed + _MISSED_ANYWAY * np.median(missed), 1e-18))


def _lit_around(survey: Survey, place: NDArray[np.int64]) -> NDArray[np.float64]:
    """What the pixels of a cross, and far light, show around each row's place, (m, K, d)."""
    patterns = survey.patterns
    shown = patterns.at(cross(place, patterns.shape)).astype(np.float64)
    columns = [np.moveaxis(shown, 0, 1)]
    if survey.distinct_patterns >= _ENOUGH_PATTERNS:
        windows = (
            window_around(place, patterns.shape, 2 * spread, spread, spread // 2)
            for spread in _AROUND
        )
        columns += [mean_around(patterns, *each)[..., None] for each in windows]
    return np.concatenate(columns, axis=2)


def cross(places: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    """The pixels at some places and beside them, (m, 5), within the projector."""
    row, col = np.divmod(places, shape[1])
    pixels = [
        np.clip(row + down, 0, shape[0] - 1) * shape[1] + np.clip(col + right, 0, shape[1] - 1)
        for down, right in _CROSS
    ]
    return np.stack(pixels, axis=1)
