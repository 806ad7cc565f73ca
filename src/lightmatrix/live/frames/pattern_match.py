"""Whether a frame shows its pattern, told while frames come in.

As in the check of finished captures (`lightmatrix.diagnosis.frame_order`), some camera samples are
explained by a few projector pixels each, from the frames there are, and what they should show under
every other pattern is predicted. A frame shows its pattern if it meets the prediction; if it does
not, or meets a mixture with the pattern shown before, all over or from some row on, it is late or
torn. Frames that came before enough was known are looked at again later.

Scenes without direct light, few patterns, and patterns of single pixels predict nothing; then
nothing is said, and the frames are confirmed by a second photograph instead.
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
from lightmatrix.live.frames.previous_pattern import Mixture, find_mixture
from lightmatrix.patterns.pattern_set import PatternSet

# Frames before which nothing is predicted: as many as tell the pixels apart, and these.
_SPARE_FRAMES = 8
# Projectors of more pixels are looked through less often, as it takes seconds each time.
_LARGE = 100_000
_LARGE_FOLDS = 3
# Samples that are watched: where all are looked for among all pixels; and where few are, each with
# 24 neighbours, at most so many rows and columns from one to the next.
_MOST, _FEWEST, _STEP = 1024, 64, 3
# Share of a sample's variance that must be predicted for it to have a say, and how many must.
_EXPLAINED = 0.5
_FEWEST_TELLING = 24
# Of the variance of a frame: misses above this, or above so many times the usual one, accuse it.
_MOST_MISSED = 0.25
_TIMES_USUAL = 3.0
# Of a square error, the most that one sample says.
_GLINT = 25.0


@dataclass(eq=False)
class Watch:
    """What some samples showed so far, and what they should show.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    rows : (m,) int
        The image row of each watched sample.
    ceiling : (m,) float
        Level up to which all exposures tell the light apart; samples and predictions end there.
    beside : int
        Samples come in groups of so many neighbours; see `watched_samples`.
    """

    patterns: PatternSet
    rows: NDArray[np.int64]
    ceiling: NDArray[np.float32]
    beside: int = 1
    _values: NDArray[np.float32] = field(init=False)
    _predicted: NDArray[np.float32] | None = None
    _telling: NDArray[np.bool_] = field(init=False)
    _error: NDArray[np.float32] = field(init=False)
    _usual: float = 1.0
    # Errors of shares as they are found, over those that they should have.
    _spread: float = 1.0
    _scale: NDArray[np.float32] | None = None
    # Whether anything has changed since it was learnt from, and how many frames there were then.
    _new: bool = True
    _learnt: int = 0

    def __post_init__(self) -> None:
        self._values = np.full((len(self.rows), self.patterns.count), np.nan, np.float32)
        self._telling = np.zeros(len(self.rows), bool)
        self._error = np.ones(len(self.rows), np.float32)

    @property
    def predictive(self) -> bool:
        """Whether enough is known to say of a frame that it shows its pattern."""
        return self._predicted is not None

    @property
    def due(self) -> bool:
        """Whether there are enough new frames for it to be worth learning again."""
        count = int(np.isfinite(self._values[0]).sum())
        growth = 2.0 if self.patterns.pixels > _LARGE else 1.5
        return count >= max(self._fewest, growth * self._learnt)

    @property
    def _fewest(self) -> int:
        return _SPARE_FRAMES + int(np.ceil(np.log2(self.patterns.pixels)))

    def put(self, frame: int, samples: NDArray[np.float32]) -> None:
        """Note what the watched samples (m,) show in a frame; NaN where it is not trusted."""
        self._values[:, frame] = np.minimum(samples, self.ceiling)
        self._new = True

    def forget(self, frame: int) -> None:
        """Explain nothing from a frame any more."""
        self._values[:, frame] = np.nan
        self._new = True

    def learn(self) -> None:
        """Explain the samples from the frames there are, and predict all patterns."""
        if not self._new:
            return
        self._new = False
        taken = np.flatnonzero(np.isfinite(self._values[0]))
        self._predicted, self._learnt = None, len(taken)
        if len(taken) < self._fewest:
            return
        if self._scale is None:
            self._scale = column_scale(self.patterns)
        # What all samples do together is the brightness of the frame: flicker, mean of the pattern.
        light = np.full_like(self._values, np.nan)
        light[:, taken] = self._values[:, taken]
        light[:, taken] -= light[:, taken].mean(axis=0)
        parts = _LARGE_FOLDS if self.patterns.pixels > _LARGE else fold_count(len(taken))
        fold = np.full(self.patterns.count, -1)
        fold[taken] = np.random.default_rng(0).permutation(len(taken)) % parts
        predicted = predict_by_pursuit(self.patterns, self._scale, light, fold, self.beside)
        observed = light[:, taken]
        spread = observed - observed.mean(axis=1, keepdims=True)
        missed = observed - predicted[:, taken]
        explained = 1 - (missed**2).sum(axis=1) / np.maximum((spread**2).sum(axis=1), 1e-12)
        telling = explained > _EXPLAINED
        if telling.sum() < _FEWEST_TELLING:
            return
        self._predicted, self._telling = predicted, telling
        # Of most frames, not of the few that are wrong.
        self._error = np.maximum(1.48 * np.median(np.abs(missed), axis=1), 1e-3 * self.ceiling)
        self._usual = float(np.median([self._missed(int(k)) for k in taken]))
        if self._usual > _EXPLAINED:
            self._predicted = None
            return
        # Predictions of neighbouring samples err alike, which no sum over samples knows of. Most
        # frames are right, whatever was shown before them.
        self._spread = 1.0
        mixes = [self._mixture(int(k), int(k) - 1) for k in taken if k > 0]
        found = [abs(mix.share) / mix.error for mix in mixes if mix is not None]
        self._spread = max(1.0, 1.48 * float(np.median(found)))

    def complaint(self, frame: int, before: int) -> str | None:
        """What is wrong with a frame that was put; None if it shows its pattern.

        Parameters
        ----------
        frame : int
            Number of its pattern.
        before : int
            The pattern shown before it; below 0 for black or white.
        """
        mix = self._mixture(frame, before)
        if mix is not None and (told := mix.said()) is not None:
            return told
        if self._missed(frame) > max(_MOST_MISSED, _TIMES_USUAL * self._usual):
            return "does not show its pattern"
        return None

    def excludes(self, frame: int, before: int, noise: float) -> bool:
        """Whether a frame has no share of the pattern shown before it that does harm.

        That is never known after black or white, which change a frame as a lamp does that flickers.

        Parameters
        ----------
        frame, before
            As `complaint` has them.
        noise : float
            Standard deviation of a sample, in the unit of what was put.
        """
        mix = self._mixture(frame, before)
        return mix is not None and mix.excluded(noise)

    def _missed(self, frame: int) -> float:
        """Share of a frame's variance that its prediction misses."""
        observed, expected, error = self._compared(frame)
        usual = np.nanmean(self._values[self._telling], axis=1, dtype=np.float64)
        power = ((observed - usual) / error) ** 2
        missed = (observed - expected) / error
        # No sample says more than many, or a glint would speak for all.
        return float(
            np.minimum(missed**2, _GLINT).sum() / max(float(np.minimum(power, _GLINT).sum()), 1)
        )

    def _mixture(self, frame: int, before: int) -> Mixture | None:
        """How much of the pattern before is in a frame; None where that was black, white or it."""
        if before < 0 or before == frame:
            return None
        observed, expected, error = self._compared(frame)
        assert self._predicted is not None
        some = self._telling
        other = self._at_level(self._predicted[some, before], observed, some)
        limit = np.sqrt(_GLINT) * error
        missed = np.clip(observed - expected, -limit, limit)
        found = find_mixture(missed, other, expected, error, self.rows[some])
        return replace(found, error=self._spread * found.error)

    def _compared(
        self, frame: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What telling samples show in a frame, what they should, and the usual error of that."""
        assert self._predicted is not None
        some = self._telling
        observed = self._values[some, frame].astype(np.float64)
        expected = self._at_level(self._predicted[some, frame], observed, some)
        return observed, expected, self._error[some].astype(np.float64)

    def _at_level(
        self,
        predicted: NDArray[np.float32],
        observed: NDArray[np.float64],
        some: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """A prediction at the brightness of a frame, which it does not know, and cut off."""
        level = float(np.median(observed - predicted))
        return np.minimum(predicted + level, self.ceiling[some]).astype(np.float64)


def watched_samples(
    light: NDArray[np.floating], patterns: PatternSet
) -> tuple[NDArray[np.int64], int]:
    """Which samples to watch: lit ones, spread over the image.

    Parameters
    ----------
    light : (rows, cols[, channels]) float
        White frame less black frame.
    patterns : PatternSet
        Where they have many pixels, few samples are looked for among all of them.

    Returns
    -------
    index : (m,) int64
        Of the flat image.
    beside : int
        Samples come in groups of so many neighbours; in order, where it is 1.
    """
    generator = np.random.default_rng(0)
    rows, cols = light.shape[:2]
    by_row = np.asarray(light).reshape(rows, -1)
    wanted, places = _MOST, np.zeros(1, np.int64)
    if patterns.pixels > SEARCHED_WHOLE and min(rows, cols) > 8 * _STEP:
        # About as far apart as to see other projector pixels, and these near to each other.
        step = int(np.clip(_STEP * rows / patterns.shape[0], 1, _STEP))
        wanted, places = _FEWEST, step * np.arange(-2, 3)
        inner = np.zeros(light.shape, bool)
        inner[places[-1] : places[0], places[-1] : places[0]] = True
        by_row = np.where(inner.reshape(rows, -1), by_row, 0)
    threshold = 0.1 * np.quantile(by_row, 0.99)
    groups = min(rows, 64)
    share = -(-wanted // groups)
    found = []
    for part in np.array_split(np.arange(rows), groups):
        block = by_row[part]
        lit = np.flatnonzero(block > threshold)
        pick = generator.permutation(lit)[:share]
        found.append(part[0] * by_row.shape[1] + pick)
    index = np.sort(np.concatenate(found)).astype(np.int64)
    down, across = np.meshgrid(places, places, indexing="ij")
    offsets = (down * by_row.shape[1] + across * (by_row.shape[1] // cols)).ravel()
    # The one that is looked for is the first.
    offsets = offsets[np.argsort(offsets != 0, kind="stable")]
    return (index[:, None] + offsets).ravel(), len(offsets)
