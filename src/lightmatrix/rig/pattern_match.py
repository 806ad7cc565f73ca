"""Whether a frame shows its own pattern, judged while frames come in.

As in the check of finished captures (`lightmatrix.check.frame_order`), some camera samples are
explained by a few projector pixels each, from the frames so far, and their values under all
patterns are predicted. A frame shows its pattern if it meets the prediction. If it does not, or
meets a mixture with the pattern shown before, all over or from some row on, it is late or torn.
Frames that came before enough was known are judged again later.

An image that comes late may come within the exposure. The frame is then (1 - a) times its own
pattern's and a times that of the pattern before. Weighted least squares fits the share a and its
standard error, from predictions for both patterns. The frame's own contrast and level are fitted
too: predictions are off in these, in all samples alike, by more than the shares that matter.

Scenes without direct light, few patterns, and patterns of single pixels predict nothing. Frames
are then confirmed by a second photograph instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.pursuit import SEARCHED_WHOLE, column_scale, fold_count, predict_by_pursuit
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.rig.photograph import MEDIAN_TO_DEVIATION


@dataclass(frozen=True)
class _Tolerances:
    """When a frame is doubted, and when it is certain that something is wrong with it.

    Chosen by `python -m tests.rig.rig_mixtures`, which measures what passes.
    """

    # Up to so many standard errors of a share it may be none at all; beyond the second number it is
    # certain that there is one.
    doubted: float = 1.5
    certain: float = 5.0
    # Shares below this are harmless, and so are those that add less light than the noise. A larger
    # share is doubted unless chance lowers it by 2 standard errors, which happens once in 40 times.
    harmless: float = 0.01
    missed_errors: float = 2.0
    # Rows at one end of the image are torn if their share is above the first and above so many
    # standard errors. The bound is high because many rows are tested, and because predictions of
    # neighbouring rows err alike.
    torn: float = 0.015
    torn_errors: float = 6.0
    # A sample is predictable if the prediction explains this share of its variance, and frames are
    # judged only if there are this many such samples.
    explained: float = 0.5
    fewest: int = 24
    # A frame is wrong if the prediction misses this share of its variance, and so many times the
    # usual share.
    most_missed: float = 0.25
    times_usual: float = 3.0
    # An error counts at most this many standard deviations, lest a glint decide for all samples.
    farthest: float = 5.0


_TOLERANCES = _Tolerances()


@dataclass(frozen=True)
class Mixture:
    """Share of another pattern in a frame."""

    # The share over the whole frame, and its standard error.
    share: float
    error: float
    # Whether some rows at the top or bottom show the other pattern.
    torn: bool
    # Difference between the light of both patterns (root mean square), in levels.
    contrast: float

    def excluded(self, noise: float) -> bool:
        """Whether no harmful share is in the frame; `noise` is that of a sample, in levels."""
        harmful = max(_TOLERANCES.harmless, noise / max(self.contrast, 1e-9))
        doubted = _TOLERANCES.doubted * self.error
        visible = doubted + _TOLERANCES.missed_errors * self.error <= harmful
        return visible and self.share <= doubted

    def complaint(self) -> str | None:
        """What is wrong with the frame; None if nothing is certain."""
        if self.share > _TOLERANCES.certain * self.error:
            return f"shows {100 * min(self.share, 1):.0f} % of the pattern before"
        if self.torn:
            return "shows some of the pattern before in some of its rows"
        return None


def fit_mixture(
    missed: NDArray[np.float64],
    other: NDArray[np.float64],
    own: NDArray[np.float64],
    error: NDArray[np.float64],
    rows: NDArray[np.int64],
) -> Mixture:
    """Fit the share of another pattern in a frame, as a whole and from each row up and down.

    All are (m,): what the own pattern's prediction `missed`, both predictions, the standard
    deviation of `missed` where all is right, and each sample's image row.
    """
    nuisance, _ = np.linalg.qr(np.column_stack([own, np.ones_like(own)]) / error[:, None])

    def without_nuisance(values: NDArray[np.float64]) -> NDArray[np.float64]:
        weighted = values / error
        return np.asarray(weighted - nuisance @ (nuisance.T @ weighted))

    rest, towards = without_nuisance(missed), without_nuisance(other)
    order = np.argsort(rows, kind="stable")
    scale = max(1.0, float(np.sqrt((rest**2).mean())))
    torn = False
    # The last cumulative sums of the second direction are those of the whole frame.
    for ordered in (order[::-1], order):
        weight = np.maximum(np.cumsum(towards[ordered] ** 2), 1e-9)
        share = np.cumsum(rest[ordered] * towards[ordered]) / weight
        errors = share * np.sqrt(weight) / scale
        clear = (share > _TOLERANCES.torn) & (errors > _TOLERANCES.torn_errors)
        # A single sample may be a glint, so at least four are needed.
        torn = torn or bool(clear[3:].any())
    contrast = float(np.sqrt(((other - own) ** 2).mean()))
    return Mixture(float(share[-1]), scale / float(np.sqrt(weight[-1])), torn, contrast)


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
        return count >= max(self._fewest, (2.0 if self._large else 1.5) * self._learnt)

    @property
    def _large(self) -> bool:
        """Whether learning takes seconds, so that it is done less often and by fewer folds."""
        return self.patterns.pixels > 100_000

    @property
    def _fewest(self) -> int:
        # Pixels can be told apart by the logarithm of their number at the least.
        return 8 + int(np.ceil(np.log2(self.patterns.pixels)))

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
        predictable = explained > _TOLERANCES.explained
        if predictable.sum() < _TOLERANCES.fewest:
            return
        self._predicted, self._predictable = predicted, predictable
        # Medians describe the many right frames, not the few wrong ones.
        deviation = MEDIAN_TO_DEVIATION * np.median(np.abs(missed), axis=1)
        self._error = np.maximum(deviation, 1e-3 * self.ceiling)
        self._usual_miss = float(np.median([self._missed(int(k)) for k in frames]))
        if self._usual_miss > _TOLERANCES.explained:
            self._predicted = None
            return
        # Predictions of neighbouring samples err alike, which makes fitted shares less certain than
        # their standard errors say. Most frames are right, whatever was shown before them.
        self._error_scale = 1.0
        mixes = [self._mixture(int(k), int(k) - 1) for k in frames if k > 0]
        ratios = [abs(mix.share) / mix.error for mix in mixes if mix is not None]
        self._error_scale = max(1.0, MEDIAN_TO_DEVIATION * float(np.median(ratios)))

    def complaint(self, frame: int, before: int) -> str | None:
        """What is wrong with a frame shown after pattern `before` (below 0: black or white)."""
        mix = self._mixture(frame, before)
        if mix is not None and (complaint := mix.complaint()) is not None:
            return complaint
        usual = max(_TOLERANCES.most_missed, _TOLERANCES.times_usual * self._usual_miss)
        if self._missed(frame) > usual:
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
        parts = 3 if self._large else fold_count(len(frames))
        fold = np.full(self.patterns.count, -1)
        fold[frames] = np.random.default_rng(0).permutation(len(frames)) % parts
        predicted = predict_by_pursuit(self.patterns, self._scale, light, fold, self.group)
        return light, predicted

    def _missed(self, frame: int) -> float:
        """Share of a frame's variance that its prediction misses."""
        observed, expected, error = self._compared(frame)
        usual = np.nanmean(self._values[self._predictable], axis=1, dtype=np.float64)
        most = _TOLERANCES.farthest**2
        power = np.minimum(((observed - usual) / error) ** 2, most).sum()
        missed = np.minimum(((observed - expected) / error) ** 2, most).sum()
        return float(missed / max(float(power), 1))

    def _mixture(self, frame: int, before: int) -> Mixture | None:
        """Share of the pattern before in a frame; None if that was black, white or its own."""
        if before < 0 or before == frame:
            return None
        observed, expected, error = self._compared(frame)
        other = self._at_level(before, observed)
        limit = _TOLERANCES.farthest * error
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
    # The numbers of samples and of groups are those that can be learnt in about a second.
    wanted, places = 1024, np.zeros(1, np.int64)
    if patterns.pixels > SEARCHED_WHOLE and min(rows, cols) > 24:
        # Neighbours should see other projector pixels than the middle one, but near ones.
        step = int(np.clip(3 * rows / patterns.shape[0], 1, 3))
        wanted, places = 64, step * np.arange(-2, 3)
        inner = np.zeros(light.shape, bool)
        inner[places[-1] : places[0], places[-1] : places[0]] = True
        by_row = np.where(inner.reshape(rows, -1), by_row, 0)
    # A sample is lit if it has a tenth of the light of the brightest 1 %. Bands of rows give the
    # same number each, so that the samples cover the whole image.
    threshold = 0.1 * np.quantile(by_row, 0.99)
    bands = min(rows, 64)
    chosen = []
    for band in np.array_split(np.arange(rows), bands):
        lit = np.flatnonzero(by_row[band] > threshold)
        pick = generator.permutation(lit)[: -(-wanted // bands)]
        chosen.append(band[0] * by_row.shape[1] + pick)
    index = np.sort(np.concatenate(chosen)).astype(np.int64)
    down, across = np.meshgrid(places, places, indexing="ij")
    offsets = (down * by_row.shape[1] + across * (by_row.shape[1] // cols)).ravel()
    # The middle sample, which is searched for among all pixels, comes first.
    offsets = offsets[np.argsort(offsets != 0, kind="stable")]
    return (index[:, None] + offsets).ravel(), len(offsets)
