"""What a camera pixel should show in each frame, predicted from its other frames.

A camera pixel sees a few places of the projector and, faintly, all of it. Ridge regression explains
its samples from windows of projector pixels around the two places that correlate best, from the
mean around the first of them, and from the mean of the pattern. What it should show in frame k is
predicted from the other frames only (leave-one-out, in closed form from the diagonal of the hat
matrix).

The differences are the noise against which the checks measure everything else: they show how well
the pixel can be predicted at all, and only larger differences mean that something is wrong. The
windows are chosen from all frames, also from the predicted one, so that a frame that shows another
pattern makes its own look a little likelier. Doubted frames are therefore predicted once more, by
windows that were chosen without them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.codes import best_code_pixels
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.resources.threads import one_blas_thread, work_ahead

# Light is expected to fall off around the two places of a row like a Gaussian of standard deviation
# 1 pixel, at half the scale around the second place. Each row takes the ridge that predicts it
# best. These priors were chosen by hand.
_PLACE_SCALES = (1.0, 0.5)
_RIDGES = (0.003, 0.03, 0.3)


@dataclass(frozen=True, eq=False)
class FramePrediction:
    """Linear samples of m rows in K frames, and what each should be by its other frames."""

    observed: NDArray[np.float64]
    expected: NDArray[np.float64]
    # Whether the two may be compared: the sample is not clipped, nor expected to be close to it.
    trusted: NDArray[np.bool_]
    # Mean square difference of each row, as a share of its variance, (m,).
    miss: NDArray[np.float64]
    # Projector pixels around which each row was explained, (m,) each.
    places: tuple[NDArray[np.int64], ...]
    # The part of the projector that each row follows, (m,). What a window does not explain is alike
    # in the rows of a part, which are therefore no independent witnesses.
    part: NDArray[np.int64]

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Which rows can be predicted, (m,)."""
        return (self.miss < 0.4) & (self.trusted.sum(axis=1) >= 8)

    def rows(self, index: NDArray[np.bool_] | NDArray[np.integer]) -> "FramePrediction":
        """The prediction of some rows."""
        return replace(
            self, observed=self.observed[index], expected=self.expected[index],
            trusted=self.trusted[index], miss=self.miss[index],
            places=tuple(place[index] for place in self.places), part=self.part[index],
        )  # fmt: skip


def column_scale(patterns: PatternSet) -> NDArray[np.float32]:
    """One over the standard deviation of each projector pixel over the patterns; 0 if constant."""
    mean = patterns.weighted_sum(np.full(patterns.count, 1 / patterns.count))
    variance = patterns.squares / patterns.count - mean**2
    scale = np.zeros(patterns.pixels, np.float32)
    varied = variance > 1e-6
    scale[varied] = 1 / np.sqrt(variance[varied])
    return scale


def best_pixels(
    patterns: PatternSet, scale: NDArray[np.float32], residual: NDArray[np.floating]
) -> NDArray[np.int64]:
    """The projector pixel that correlates best with each row of residuals (m, K), (m,).

    `scale` (N,) is that of `column_scale`.
    """

    def best_of(rows: slice, pixels: slice, scores: NDArray[np.float32]) -> tuple[Any, ...]:
        scores *= scale[pixels]
        found = scores.argmax(axis=1)
        return rows, found + pixels.start, np.take_along_axis(scores, found[:, None], axis=1)[:, 0]

    best = np.zeros(len(residual), np.int64)
    highest = np.full(len(residual), -np.inf, np.float32)
    for rows, found, score in patterns.correlations(residual.astype(np.float32), best_of):
        better = score > highest[rows]
        best[rows] = np.where(better, found, best[rows])
        highest[rows] = np.maximum(score, highest[rows])
    return best


def find_places(
    patterns: PatternSet, samples: Samples, learned: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], ...]:
    """The projector pixels that m rows follow most in their `learned` (m, K) samples, (m,) each."""
    weight = learned.astype(np.float64)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1)
    residual = weight * (samples.values - (weight * samples.values).sum(axis=1)[:, None] / total)
    places: list[NDArray[np.int64]] = []
    while True:
        best = best_code_pixels(patterns, residual)
        if best is None:
            best = best_pixels(patterns, column_scale(patterns), residual)
        places.append(best)
        if len(places) == len(_PLACE_SCALES):
            return tuple(places)
        column = patterns.columns(places[-1]).T.astype(np.float64)
        column = weight * (column - (weight * column).sum(axis=1)[:, None] / total)
        power = np.maximum((column**2).sum(axis=1), 1e-9)
        residual = residual - ((column * residual).sum(axis=1) / power)[:, None] * column


def predict(
    patterns: PatternSet, samples: Samples, doubted: NDArray[np.bool_] | None = None
) -> FramePrediction:
    """Predict every sample (m, K) from the row's other frames.

    Nothing is learned from `doubted` frames (K,), but they are predicted too.
    """
    learned = ~samples.clipped
    if doubted is not None:
        learned = learned & ~doubted
    places = find_places(patterns, samples, learned)
    observed = np.asarray(samples.values, np.float64)
    level = np.broadcast_to(samples.clip_level, observed.shape)
    windows = [window_around(place, patterns.shape) for place in places]
    # Blurred light reaches further: the mean around the first place is one more column.
    around = window_around(places[0], patterns.shape, 6, 3.0, 2)
    # Every pixel of a window is a column, and so are their surroundings and the mean.
    row_bytes = 8 * patterns.count * (sum(pixels.shape[1] for pixels, _ in [*windows, around]) + 1)
    # Each thread holds 2 MiB of columns at a time, which caches hold too.
    step = max(1, (2 << 20) // row_bytes)
    expected = np.empty_like(observed)
    miss = np.empty(len(observed))
    known = np.empty(observed.shape, bool)

    def explain(some: slice) -> tuple[NDArray[Any], ...]:
        columns = _columns(
            patterns,
            [(pixels[some], scale[some]) for pixels, scale in windows],
            (around[0][some], around[1][some]),
        )
        return _left_out(columns, observed[some], learned[some])

    blocks = [slice(start, start + step) for start in range(0, len(observed), step)]
    with one_blas_thread():
        for some, explained in zip(blocks, work_ahead(explain, blocks), strict=True):
            expected[some], miss[some], known[some] = explained
    usual = np.sqrt(miss * np.maximum(observed.var(axis=1), 1e-18))[:, None]
    # A row that is expected to come close to the clip level shows its noise from one side only.
    trusted = known & ~samples.clipped & (expected + 3 * usual < level)
    # The projector has 4 x 4 parts.
    row, col = np.divmod(places[0], patterns.shape[1])
    down, right = (-(-size // 4) for size in patterns.shape)
    return FramePrediction(
        observed, expected, trusted, miss, places, row // down * 4 + col // right
    )


def _left_out(
    columns: NDArray[np.float64], observed: NDArray[np.float64], learned: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """What each sample should be by the others (m, K), and the share of variance missed, (m,).

    Last comes whether the others can tell of a sample, (m, K).
    """
    count = observed.shape[1]
    train = np.zeros(count, bool)
    # More frames take longer.
    train[np.random.default_rng(0).permutation(count)[:192]] = True
    weight = (learned & train).astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1)
    mean = (weight * observed).sum(axis=1) / total
    centre = np.einsum("mk,mkd->md", weight, columns) / total[:, None]
    columns = columns - centre[:, None, :]
    difference = observed - mean[:, None]
    variance = np.maximum((weight * difference**2).sum(axis=1) / total, 1e-18)
    best = np.full(len(observed), np.inf)
    expected = np.zeros_like(observed)
    known = np.zeros(observed.shape, bool)
    for fitted, lever in _ridge_fits(columns, weight, difference):
        lever += 1 / total[:, None]
        own = weight * lever
        # What is left of a sample once it no longer explains itself.
        left = (difference - fitted) / np.maximum(1 - own, 0.02)
        error = (weight * left**2).sum(axis=1) / total
        better = error < best
        best = np.where(better, error, best)
        expected = np.where(better[:, None], observed - left, expected)
        # What is not its own in a sample that is learned from, or would be if it were.
        others = np.where(weight > 0, 1 - lever, 1 / (1 + lever))
        usual = np.median(others, axis=1, keepdims=True)
        # The others cannot tell of a sample that the fit follows nearly alone: they need a tenth of
        # it, and a quarter of what they usually have of the row's samples. With few frames they
        # have less than a tenth; then half of it is enough. Chosen on intact captures of 15 scenes
        # under 13 kinds of patterns (`benchmarks/synthetic_captures.py`).
        least = np.where(usual > 0.1, np.maximum(0.1, usual / 4), usual / 2)
        known = np.where(better[:, None], others > least, known)
    return expected, best / variance, known


def _ridge_fits(
    columns: NDArray[np.float64], weight: NDArray[np.float64], values: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Each ridge's fit of the values (m, K), and how much each value sways its own fit, (m, K).

    With columns X (m, K, d) and weights W, 0 or 1, the second is the diagonal of
    ``X (X'WX + r)^-1 X'``. Where frames are fewer than columns, the equal
    ``(XX' - XX'W (WXX'W + r)^-1 WXX') / r`` has the smaller inverse.
    """
    turned = np.swapaxes(columns, 1, 2)
    lit = (weight * values)[:, :, None]
    frames, size = columns.shape[1:]
    if frames < size:
        alike = columns @ turned
        seen = alike * weight[:, None, :]
        gram = weight[:, :, None] * seen
        whole = np.einsum("mkk->mk", alike)
        for ridge in _RIDGES:
            share = seen @ np.linalg.inv(gram + ridge * np.eye(frames))
            lever = (whole - np.einsum("mkl,mkl->mk", share, seen)) / ridge
            yield (share @ lit)[..., 0], lever
        return
    gram = turned @ (columns * weight[:, :, None])
    slope = turned @ lit
    for ridge in _RIDGES:
        inverse = np.linalg.inv(gram + ridge * np.eye(size))
        lever = np.einsum("mkd,mkd->mk", columns @ inverse, columns)
        yield (columns @ (inverse @ slope))[..., 0], lever


def _columns(
    patterns: PatternSet,
    windows: list[tuple[NDArray[np.int64], NDArray[np.float64]]],
    around: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """What explains rows: (m, K, d), each column in the scale that is expected of it."""
    parts = []
    for (pixels, scale), size in zip(windows, _PLACE_SCALES, strict=True):
        parts.append(np.moveaxis(patterns.at(pixels), 0, 1) * (size * scale)[:, None, :])
    parts.append(0.3 * mean_around(patterns, *around)[..., None])
    spread = float(patterns.means.std())
    means = (
        (patterns.means - patterns.means.mean()) / spread if spread > 1e-6 else 0 * patterns.means
    )
    rows = len(windows[0][0])
    parts.append(np.broadcast_to((0.1 * means)[None, :, None], (rows, patterns.count, 1)))
    return np.asarray(np.concatenate(parts, axis=2), np.float64)


def mean_around(
    patterns: PatternSet, pixels: NDArray[np.int64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted means of windows (m, d) in each pattern, (m, K), of mean 0 and deviation 1."""
    mean = np.einsum("kmd,md->mk", patterns.at(pixels), scale**2)
    mean = mean - mean.mean(axis=1, keepdims=True)
    return np.asarray(mean / np.maximum(mean.std(axis=1, keepdims=True), 1e-6))


def window_around(
    place: NDArray[np.int64],
    shape: tuple[int, int],
    reach: int = 2,
    spread: float = 1.0,
    step: int = 1,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Every `step`-th pixel of the windows around places, (m, d), and the scale of each; 0 outside.

    The squared scale is a Gaussian of standard deviation `spread`.
    """
    offset = np.arange(-reach, reach + 1, step)
    down, right = (each.ravel() for each in np.meshgrid(offset, offset, indexing="ij"))
    row, col = np.divmod(place, shape[1])
    row, col = row[:, None] + down, col[:, None] + right
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    scale = np.exp(-(down**2 + right**2) / (4 * spread**2))
    pixels = np.where(inside, row * shape[1] + col, 0).astype(np.int64)
    return pixels, np.where(inside, scale, 0.0)
