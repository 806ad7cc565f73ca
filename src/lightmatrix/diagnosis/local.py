"""What a camera pixel should show in each frame, predicted from its other frames.

A camera pixel sees a few places of the projector and, faintly, all of it. So its samples are
explained, by regularized least squares, from small windows of projector pixels around the places
that correlate best, and from the mean of the pattern. What it should show in frame k is what the
explanation gives that never saw frame k (leave-one-out, in closed form from the diagonal of the hat
matrix). The differences say how well the pixel can be predicted at all, and only differences beyond
that say that something is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.prediction import column_scale
from lightmatrix.patterns.pattern_set import PatternSet

# Projector pixels to each side of a place, and the spread of light around it that is assumed.
_REACH, _SPREAD = 2, 1.0
# Places of a row, each with the scale of what is expected of it.
_PLACES = (1.0, 0.5)
_MEAN_SCALE = 0.1
_RIDGES = (0.003, 0.03, 0.3)
# Values of the explaining columns held at a time; frames that rows are explained from.
_MOST_VALUES = 1 << 23
_MOST_FRAMES = 192
_CORRELATION_BYTES = 64 << 20
# A prediction that misses more than this share of a row's variance is none.
PREDICTED = 0.4


@dataclass(frozen=True, eq=False)
class Prediction:
    """Samples of m rows in K frames, and what each should be by its other frames.

    Parameters
    ----------
    observed, expected : (m, K) float64
        Linear samples.
    trusted : (m, K) bool
        Whether the two may be compared: the sample is not clipped, nor expected to be close to it.
    miss : (m,) float64
        Mean square difference of each row, as a share of its variance.
    places : tuple of (m,) int
        Projector pixels around which each row was explained.
    """

    observed: NDArray[np.float64]
    expected: NDArray[np.float64]
    trusted: NDArray[np.bool_]
    miss: NDArray[np.float64]
    places: tuple[NDArray[np.int64], ...]

    @cached_property
    def noise(self) -> NDArray[np.float64]:
        """What the differences of each row usually are, (m, 1); robust against a few odd ones."""
        difference = np.where(self.trusted, np.abs(self.observed - self.expected), np.nan)
        usual = 1.4826 * np.nanmedian(difference, axis=1, keepdims=True)
        return np.asarray(np.maximum(usual, 1e-9))

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Which rows can be predicted, (m,)."""
        return (self.miss < PREDICTED) & (self.trusted.sum(axis=1) >= 8)

    def rows(self, index: NDArray[np.bool_] | NDArray[np.integer]) -> Prediction:
        """The prediction of some rows."""
        return Prediction(
            self.observed[index],
            self.expected[index],
            self.trusted[index],
            self.miss[index],
            tuple(place[index] for place in self.places),
        )

    def frames(self, index: NDArray[np.integer]) -> Prediction:
        """The prediction of some frames."""
        return Prediction(
            self.observed[:, index],
            self.expected[:, index],
            self.trusted[:, index],
            self.miss,
            self.places,
        )


def find_places(
    patterns: PatternSet,
    samples: Samples,
    learned: NDArray[np.bool_] | None = None,
    most: int = len(_PLACES),
) -> tuple[NDArray[np.int64], ...]:
    """The projector pixels that each row follows most, one after the other; (m,) each.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    samples : Samples
        (m, K) linear samples.
    learned : (m, K) bool, optional
        Which samples tell; None means those that are not clipped.
    most : int
        How many places.
    """
    scale = column_scale(patterns)
    weight = (~samples.clipped if learned is None else learned).astype(np.float64)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1)
    residual = weight * (samples.values - (weight * samples.values).sum(axis=1)[:, None] / total)
    found: list[NDArray[np.int64]] = []
    for number in range(most):
        best = _best_pixels(patterns, scale, residual)
        found.append(best)
        if number + 1 < most:
            column = patterns.columns(best).T.astype(np.float64)
            column = weight * (column - (weight * column).sum(axis=1)[:, None] / total)
            power = np.maximum((column**2).sum(axis=1), 1e-9)
            residual = residual - ((column * residual).sum(axis=1) / power)[:, None] * column
    return tuple(found)


def predict(
    patterns: PatternSet,
    samples: Samples,
    places: tuple[NDArray[np.int64], ...] | None = None,
    doubted: NDArray[np.bool_] | None = None,
) -> Prediction:
    """Predict every sample of some rows from the row's other frames.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    samples : Samples
        (m, K) linear samples.
    places : tuple of (m,) int, optional
        As from `find_places`, which None asks for.
    doubted : (K,) bool, optional
        Frames that nothing is learned from; they are predicted all the same.
    """
    learned = ~samples.clipped
    if doubted is not None:
        learned = learned & ~doubted
    if places is None:
        places = find_places(patterns, samples, learned)
    observed = np.asarray(samples.values, np.float64)
    level = np.broadcast_to(samples.clip_level, observed.shape)
    windows = [_window(place, patterns.shape) for place in places]
    size = len(_PLACES) * (2 * _REACH + 1) ** 2 + 1
    step = max(1, _MOST_VALUES // (patterns.count * size))
    expected = np.empty_like(observed)
    miss = np.empty(len(observed))
    for start in range(0, len(observed), step):
        part = slice(start, start + step)
        columns = _columns(patterns, [(n[part], scale[part]) for n, scale in windows])
        expected[part], miss[part] = _left_out(columns, observed[part], learned[part])
    usual = np.sqrt(miss * np.maximum(observed.var(axis=1), 1e-18))[:, None]
    # A row that is expected to come close to the clip level shows its noise from one side only.
    trusted = ~samples.clipped & (expected + 3 * usual < level)
    return Prediction(observed, expected, trusted, miss, places)


def _left_out(
    columns: NDArray[np.float64], observed: NDArray[np.float64], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What each sample should be by the others (m, K), and the share of variance missed, (m,)."""
    count = observed.shape[1]
    train = np.zeros(count, bool)
    train[np.random.default_rng(0).permutation(count)[:_MOST_FRAMES]] = True
    weight = (seen & train).astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1)
    mean = (weight * observed).sum(axis=1) / total
    centre = np.einsum("mk,mkd->md", weight, columns) / total[:, None]
    columns = columns - centre[:, None, :]
    difference = observed - mean[:, None]
    weighted = columns * weight[:, :, None]
    gram = np.swapaxes(weighted, 1, 2) @ columns
    slope = (np.swapaxes(weighted, 1, 2) @ difference[:, :, None])[..., 0]
    variance = np.maximum((weight * difference**2).sum(axis=1) / total, 1e-18)
    best = np.full(len(observed), np.inf)
    expected = np.zeros_like(observed)
    for ridge in _RIDGES:
        inverse = np.linalg.inv(gram + ridge * np.eye(gram.shape[1]))
        fitted = (columns @ (inverse @ slope[:, :, None]))[..., 0]
        own = weight * (np.einsum("mkd,mkd->mk", columns @ inverse, columns) + 1 / total[:, None])
        # What is left of a sample once it no longer explains itself.
        left = (difference - fitted) / np.maximum(1 - own, 0.02)
        error = (weight * left**2).sum(axis=1) / total
        better = error < best
        best = np.where(better, error, best)
        expected = np.where(better[:, None], observed - left, expected)
    return expected, best / variance


def _columns(
    patterns: PatternSet, windows: list[tuple[NDArray[np.int64], NDArray[np.float64]]]
) -> NDArray[np.float64]:
    """What explains rows: (m, K, d), each column in the scale that is expected of it."""
    parts = []
    for (pixels, scale), size in zip(windows, _PLACES, strict=True):
        shown = patterns.columns(pixels.ravel()).reshape(patterns.count, *pixels.shape)
        parts.append(np.moveaxis(shown, 0, 1) * (size * scale)[:, None, :])
    spread = float(patterns.means.std())
    means = (
        (patterns.means - patterns.means.mean()) / spread if spread > 1e-6 else 0 * patterns.means
    )
    rows = len(windows[0][0])
    parts.append(np.broadcast_to((_MEAN_SCALE * means)[None, :, None], (rows, patterns.count, 1)))
    return np.asarray(np.concatenate(parts, axis=2), np.float64)


def _window(
    place: NDArray[np.int64], shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pixels of the windows around places, (m, d), and the scale of each; 0 outside."""
    offset = np.arange(-_REACH, _REACH + 1)
    down, right = (each.ravel() for each in np.meshgrid(offset, offset, indexing="ij"))
    row, col = np.divmod(place, shape[1])
    row, col = row[:, None] + down, col[:, None] + right
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    scale = np.exp(-(down**2 + right**2) / (4 * _SPREAD**2))
    pixels = np.where(inside, row * shape[1] + col, 0).astype(np.int64)
    return pixels, np.where(inside, scale, 0.0)


def _best_pixels(
    patterns: PatternSet, scale: NDArray[np.float32], residual: NDArray[np.float64]
) -> NDArray[np.int64]:
    """The projector pixel that correlates best with each row, (m,)."""
    group = max(1, _CORRELATION_BYTES // (4 * patterns.pixels))
    best = np.empty(len(residual), np.int64)
    for start in range(0, len(residual), group):
        scores = patterns.adjoint(residual[start : start + group].astype(np.float32))
        best[start : start + group] = (scores * scale).argmax(axis=1)
    return best
