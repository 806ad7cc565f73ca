"""Whether a frame shows its own pattern, judged while frames come in.

As in the check of finished captures (`lightmatrix.diagnosis.frame_order`), some camera samples are
explained by a few projector pixels each, from the frames so far, and their values under all
patterns are predicted. A frame shows its pattern if it meets the prediction. If it does not, or
meets a mixture with the pattern shown before, all over or from some row on, it is late or torn.
Frames that came before enough was known are judged again later.

Scenes without direct light, few patterns, and patterns of single pixels predict nothing. Frames are
then confirmed by a second photograph instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.pursuit import (
    SEARCHED_WHOLE,
    column_scale,
    fold_count,
    predict_by_pursuit,
)
from lightmatrix.live.frames.previous_pattern import Mixture, fit_mixture
from lightmatrix.patterns.pattern_set import PatternSet

# Prediction begins with this many frames more than the logarithm (base 2) of the projector pixels,
# which is the least that tells pixels apart. Chosen by hand.
_SPARE_FRAMES = 8
# Learning takes seconds for projectors of more pixels than this. They are learnt from when the
# frames have doubled instead of grown by half, and with fewer parts of cross-validation.
_LARGE_PIXELS = 100_000
_LARGE_GROWTH, _USUAL_GROWTH = 2.0, 1.5
_LARGE_FOLDS = 3
# Number of samples that are watched if each is searched for among all projector pixels, and number
# of groups of 25 neighbours if only the middle one of a group is. Chosen by hand for the time that
# learning takes.
_SAMPLES, _GROUPS = 1024, 64
# Neighbours in a group are at most this many camera pixels apart.
_NEIGHBOUR_STEP = 3
# Samples are chosen from bands of rows, at most this many, so that they cover the whole image.
_ROW_BANDS = 64
# A sample is lit if it has this share of the light of the brightest 1 % of the samples.
_LIT = 0.1
# A sample is predictable if the prediction explains this share of its variance. Frames are judged
# only if there are this many such samples. Chosen by hand.
_EXPLAINED = 0.5
_FEWEST_PREDICTABLE = 24
# A frame is wrong if the prediction misses this share of its variance, and so many times the usual
# share. Chosen by hand.
_MOST_MISSED = 0.25
_TIMES_USUAL = 3.0
# A squared error counts at most this much, in variances, lest a glint decide for all samples.
_MOST_SQUARE = 25.0
# Times the median of absolute errors this is their standard deviation.
_MEDIAN_TO_DEVIATION = 1.48


@dataclass(eq=False)
class PatternMatcher:
    """Compares what some camera samples show with what they should show."""

    # K patterns.
    patterns: PatternSet
    # (m,): the image row of each sample.
    rows: NDArray[np.int64]
    # (m,): light at which samples clip at the longest exposure; samples and predictions end there.
    ceiling: NDArray[np.float32]
    # Samples come in groups of so many neighbours; see `choose_samples`.
    group: int = 1
    _values: NDArray[np.float32] = field(init=False)
    _predicted: NDArray[np.float32] | None = None
    _predictable: NDArray[np.bool_] = field(init=False)
    _error: NDArray[np.float32] = field(init=False)
    _usual_miss: float = 1.0
    # Actual errors of fitted shares, relative to their stated standard errors.
    _error_scale: float = 1.0
    _scale: NDArray[np.float32] | None = None
    # Whether a frame has changed since `learn`, and how many frames there were then.
    _changed: bool = True
    _learnt: int = 0

    def __post_init__(self) -> None:
        self._values = np.full((len(self.rows), self.patterns.count), np.nan, np.float32)
        self._predictable = np.zeros(len(self.rows), bool)
        self._error = np.ones(len(self.rows), np.float32)

    @property
    def predictive(self) -> bool:
        """Whether enough is known to judge frames."""
        return self._predicted is not None

    @property
    def due(self) -> bool:
        """Whether enough frames have been added for another `learn`."""
        count = int(np.isfinite(self._values[0]).sum())
        growth = _LARGE_GROWTH if self.patterns.pixels > _LARGE_PIXELS else _USUAL_GROWTH
        return count >= max(self._fewest, growth * self._learnt)

    @property
    def _fewest(self) -> int:
        return _SPARE_FRAMES + int(np.ceil(np.log2(self.patterns.pixels)))

    def put(self, frame: int, samples: NDArray[np.float32]) -> None:
        """Note the samples (m,) of a frame."""
        self._values[:, frame] = np.minimum(samples, self.ceiling)
        self._changed = True

    def forget(self, frame: int) -> None:
        """Learn nothing from a frame any more."""
        self._values[:, frame] = np.nan
        self._changed = True

    def learn(self) -> None:
        """Explain the samples from the frames so far, and predict all patterns."""
        if not self._changed:
            return
        self._changed = False
        frames = np.flatnonzero(np.isfinite(self._values[0]))
        self._predicted, self._learnt = None, len(frames)
        if len(frames) < self._fewest:
            return
        light, predicted = self._predict(frames)
        observed = light[:, frames]
        spread = observed - observed.mean(axis=1, keepdims=True)
        missed = observed - predicted[:, frames]
        explained = 1 - (missed**2).sum(axis=1) / np.maximum((spread**2).sum(axis=1), 1e-12)
        predictable = explained > _EXPLAINED
        if predictable.sum() < _FEWEST_PREDICTABLE:
            return
        self._predicted, self._predictable = predicted, predictable
        # Medians describe the many right frames, not the few wrong ones.
        deviation = _MEDIAN_TO_DEVIATION * np.median(np.abs(missed), axis=1)
        self._error = np.maximum(deviation, 1e-3 * self.ceiling)
        self._usual_miss = float(np.median([self._missed(int(k)) for k in frames]))
        if self._usual_miss > _EXPLAINED:
            self._predicted = None
            return
        # Predictions of neighbouring samples err alike, which makes fitted shares less certain than
        # their standard errors say. Most frames are right, whatever was shown before them.
        self._error_scale = 1.0
        mixes = [self._mixture(int(k), int(k) - 1) for k in frames if k > 0]
        ratios = [abs(mix.share) / mix.error for mix in mixes if mix is not None]
        self._error_scale = max(1.0, _MEDIAN_TO_DEVIATION * float(np.median(ratios)))

    def complaint(self, frame: int, before: int) -> str | None:
        """What is wrong with a frame shown after pattern `before` (below 0: black or white)."""
        mix = self._mixture(frame, before)
        if mix is not None and (complaint := mix.complaint()) is not None:
            return complaint
        if self._missed(frame) > max(_MOST_MISSED, _TIMES_USUAL * self._usual_miss):
            return "does not show its pattern"
        return None

    def excludes(self, frame: int, before: int, noise: float) -> bool:
        """Whether a frame contains no harmful share of the pattern shown before it.

        That is never known after black or white: they change a frame as a flickering lamp does.
        """
        mix = self._mixture(frame, before)
        return mix is not None and mix.excluded(noise)

    def _predict(
        self, frames: NDArray[np.int64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The light of the samples (m, K), NaN for missing frames, and its prediction."""
        if self._scale is None:
            self._scale = column_scale(self.patterns)
        # Taking off the mean of all samples removes flicker and the mean of the pattern.
        light = np.full_like(self._values, np.nan)
        light[:, frames] = self._values[:, frames]
        light[:, frames] -= light[:, frames].mean(axis=0)
        parts = _LARGE_FOLDS if self.patterns.pixels > _LARGE_PIXELS else fold_count(len(frames))
        fold = np.full(self.patterns.count, -1)
        fold[frames] = np.random.default_rng(0).permutation(len(frames)) % parts
        predicted = predict_by_pursuit(self.patterns, self._scale, light, fold, self.group)
        return light, predicted

    def _missed(self, frame: int) -> float:
        """Share of a frame's variance that its prediction misses."""
        observed, expected, error = self._compared(frame)
        usual = np.nanmean(self._values[self._predictable], axis=1, dtype=np.float64)
        power = np.minimum(((observed - usual) / error) ** 2, _MOST_SQUARE).sum()
        missed = np.minimum(((observed - expected) / error) ** 2, _MOST_SQUARE).sum()
        return float(missed / max(float(power), 1))

    def _mixture(self, frame: int, before: int) -> Mixture | None:
        """Share of the pattern before in a frame; None if that was black, white or its own."""
        if before < 0 or before == frame:
            return None
        observed, expected, error = self._compared(frame)
        other = self._at_level(before, observed)
        limit = np.sqrt(_MOST_SQUARE) * error
        missed = np.clip(observed - expected, -limit, limit)
        mixture = fit_mixture(missed, other, expected, error, self.rows[self._predictable])
        return replace(mixture, error=self._error_scale * mixture.error)

    def _compared(
        self, frame: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Observed and predicted values of the predictable samples, and the usual error."""
        observed = self._values[self._predictable, frame].astype(np.float64)
        expected = self._at_level(frame, observed)
        return observed, expected, self._error[self._predictable].astype(np.float64)

    def _at_level(self, frame: int, observed: NDArray[np.float64]) -> NDArray[np.float64]:
        """The prediction of a frame at the observed brightness, which it does not contain."""
        assert self._predicted is not None
        predicted = self._predicted[self._predictable, frame]
        level = float(np.median(observed - predicted))
        return np.minimum(predicted + level, self.ceiling[self._predictable]).astype(np.float64)


def choose_samples(
    light: NDArray[np.floating], patterns: PatternSet
) -> tuple[NDArray[np.int64], int]:
    """Choose lit camera samples spread over the image (m,), and the size of their groups.

    Projectors of many pixels get few groups of neighbours, because only one sample of each group is
    searched for among all pixels. Positions are flat, in ascending order if the size is 1.
    """
    generator = np.random.default_rng(0)
    rows, cols = light.shape[:2]
    by_row = np.asarray(light).reshape(rows, -1)
    wanted, places = _SAMPLES, np.zeros(1, np.int64)
    if patterns.pixels > SEARCHED_WHOLE and min(rows, cols) > 8 * _NEIGHBOUR_STEP:
        # Neighbours should see other projector pixels than the middle one, but near ones.
        step = int(np.clip(_NEIGHBOUR_STEP * rows / patterns.shape[0], 1, _NEIGHBOUR_STEP))
        wanted, places = _GROUPS, step * np.arange(-2, 3)
        inner = np.zeros(light.shape, bool)
        inner[places[-1] : places[0], places[-1] : places[0]] = True
        by_row = np.where(inner.reshape(rows, -1), by_row, 0)
    threshold = _LIT * np.quantile(by_row, 0.99)
    bands = min(rows, _ROW_BANDS)
    share = -(-wanted // bands)
    chosen = []
    for band in np.array_split(np.arange(rows), bands):
        lit = np.flatnonzero(by_row[band] > threshold)
        pick = generator.permutation(lit)[:share]
        chosen.append(band[0] * by_row.shape[1] + pick)
    index = np.sort(np.concatenate(chosen)).astype(np.int64)
    down, across = np.meshgrid(places, places, indexing="ij")
    offsets = (down * by_row.shape[1] + across * (by_row.shape[1] // cols)).ravel()
    # The middle sample, which is searched for among all pixels, comes first.
    offsets = offsets[np.argsort(offsets != 0, kind="stable")]
    return (index[:, None] + offsets).ravel(), len(offsets)
