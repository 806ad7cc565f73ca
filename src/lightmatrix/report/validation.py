"""Photographs held out: predicted by an estimate that has not seen them.

A certificate says that a solver solved its problem; only photographs that played no part in it say
whether the solution is what the camera sees. So some frames are set aside, T is estimated once more
from the others, and what it gives under their patterns is held against them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import LightMatrixError
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.work import Progress
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.matrix import LightTransport

# One of so many frames, and no more than a few: what is left has to find T.
_ONE_OF, _MOST = 16, 4
# Fewer frames cannot spare one.
_FEWEST = 8
# Of a pattern's contrast, what the other patterns must leave unexplained.
_NEW = 0.2
_SAMPLED_PIXELS = 4096
# As many frames, at most, are asked whether they explain a pattern.
_NEIGHBOURS = 1024
# Larger cameras are tested on a rectangle of so many samples.
MOST_ROWS = 16_384


class Estimator(Protocol):
    """What makes the second estimate."""

    def estimate(self, capture: Capture, *, progress: Progress | None = None) -> LightTransport:
        """From a capture to its light transport matrix."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Photographs that an estimate had not seen, and what it predicted.

    Parameters
    ----------
    frames : (h,) int
        Which frames were held out.
    photographed, predicted : (h, *camera_shape) float32
        In units of the clip level, at each frame's exposure; both end where the camera clips.
    clipped, counted : (h, *camera_shape) bool
        Samples that clipped; that count.
    error : float
        Relative L2 error of the prediction over the samples that count. A clipped one adds to it
        where the prediction stays below the clip level.
    trivial_error : float
        The same of the mean of the other photographs, which knows nothing of T.
    others : int
        Photographs that the second estimate was made from.
    place : (slice, slice) or None
        Rows and columns of the camera that were tested; None for all.
    """

    frames: NDArray[np.int64]
    photographed: NDArray[np.float32]
    predicted: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    counted: NDArray[np.bool_]
    error: float
    trivial_error: float
    others: int
    place: tuple[slice, slice] | None

    @property
    def difference(self) -> NDArray[np.float32]:
        """Predicted minus photographed, 0 where it does not count or both clip."""
        return np.where(self.counted, self.predicted - self.photographed, 0)


def hold_out(
    capture: Capture, estimator: Estimator | EstimateSettings, *, progress: Progress | None = None
) -> HeldOut | str:
    """Estimate T without some frames and predict them.

    Parameters
    ----------
    capture : Capture
        Cameras of more than 16,384 samples are tested on a rectangle of about as many, where
        their light is.
    estimator : Estimator or EstimateSettings
        How the estimate was made.
    progress : callable, optional
        Called with (done, total) rows.

    Returns
    -------
    HeldOut or str
        In words, why frames of this capture cannot be held out.
    """
    frames = choose_frames(capture.patterns)
    if isinstance(frames, str):
        return frames
    place = _place(capture, frames)
    tested = capture if place is None else capture.window(*place)
    rest = np.setdiff1d(np.arange(capture.count), frames)
    try:
        others = tested.select(rest)
        if isinstance(estimator, EstimateSettings):
            estimator = choose_estimator(others, estimator)
        found = estimator.estimate(others, progress=progress)
    except LightMatrixError as refusal:
        return f"without it the estimate is refused ({refusal.message})"
    samples = tested.select(frames).samples()
    exposures = capture.exposures[frames].astype(np.float32)
    level = samples.clip_levels_of_all()
    light = found.relight(np.stack([capture.patterns.images(k, k + 1)[0] for k in frames]))
    mean = _mean_of(tested, rest)[:, None]
    counted = samples.counted
    predicted, trivial = (
        np.minimum(guess, level) for guess in (light.reshape(len(frames), -1).T, mean)
    )

    def error(guess: NDArray[np.float32]) -> float:
        # At each frame's exposure, so that its noise counts as it was taken.
        missed, whole = ((guess - samples.values) * exposures)[counted], samples.values * exposures
        energy = float(np.square(whole[counted], dtype=np.float64).sum())
        return float(np.sqrt(np.square(missed, dtype=np.float64).sum() / max(energy, 1e-300)))

    def images(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.ascontiguousarray((values * exposures).T).reshape(-1, *tested.camera_shape)

    shape = (-1, *tested.camera_shape)
    return HeldOut(
        frames,
        images(samples.values),
        images(predicted),
        samples.clipped.T.reshape(shape),
        counted.T.reshape(shape),
        error(predicted),
        error(trivial),
        len(rest),
        place,
    )


def choose_frames(patterns: PatternSet) -> NDArray[np.int64] | str:
    """Frames whose patterns the others do not explain, spread over the capture.

    Where a pattern is a sum of others (a Gray code's is white minus its inverse), so is its
    photograph, whatever T is: predicting it tests nothing.

    Returns
    -------
    (h,) int64 or str
        In words, why there are none.
    """
    count = patterns.count
    if count < _FEWEST:
        return f"{count} photographs are too few to spare one"
    wanted = int(np.clip(count // _ONE_OF, 1, _MOST))
    # In the middle of equal stretches, but several in each to choose from.
    asked = np.unique(np.linspace(0, count - 1, min(count, 8 * wanted + 2)).astype(np.int64)[1:-1])
    new = asked[_unexplained(patterns, asked) > _NEW]
    if not len(new):
        return (
            "every pattern is a sum of others (as in a Gray code, where each is white minus its "
            "inverse), and so is its photograph, whatever T is"
        )
    spread = np.linspace(0, len(new) - 1, wanted + 2)[1:-1].round().astype(np.int64)
    return np.unique(new[spread])


def _unexplained(patterns: PatternSet, frames: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of each pattern's contrast, the share that no sum of the other patterns explains."""
    count = patterns.count
    pixels = np.random.default_rng(0).permutation(patterns.pixels)[:_SAMPLED_PIXELS]
    # Patterns that belong together stand together.
    step = -(-count // _NEIGHBOURS)
    asked = np.union1d(np.arange(0, count, step), np.concatenate([frames, frames ^ 1]))
    asked = asked[asked < count]
    shown = patterns.columns(np.sort(pixels))[asked].astype(np.float64)
    contrast = np.square(shown - shown.mean(axis=1, keepdims=True)).sum(axis=1)
    gram = shown @ shown.T
    ridge = 1e-9 * np.trace(gram) / len(gram)
    left = 1 / np.diag(np.linalg.inv(gram + ridge * np.eye(len(gram))))
    share = np.divide(left, contrast, out=np.zeros_like(left), where=contrast > 0)
    return np.asarray(share[np.searchsorted(asked, frames)])


def _place(capture: Capture, frames: NDArray[np.int64]) -> tuple[slice, slice] | None:
    """The rectangle to test of a large camera: around the middle of its light."""
    rows, cols, *channels = capture.camera_shape
    most = MOST_ROWS // (channels[0] if channels else 1)
    if rows * cols <= most:
        return None
    height = min(rows, max(1, int(np.sqrt(most * rows / cols))))
    width = min(cols, most // height)
    light = _mean_of(capture, frames).reshape(rows, cols, -1).sum(axis=2)

    def around(profile: NDArray[np.floating], length: int) -> slice:
        total = np.cumsum(np.maximum(profile, 0), dtype=np.float64)
        middle = int(np.searchsorted(total, total[-1] / 2))
        start = int(np.clip(middle - length // 2, 0, len(profile) - length))
        return slice(start, start + length)

    return around(light.sum(axis=1), height), around(light.sum(axis=0), width)


def _mean_of(capture: Capture, frames: NDArray[np.int64]) -> NDArray[np.float32]:
    """Mean over the given frames of each camera sample, (M,)."""
    chosen = capture.select(frames)
    return np.concatenate([tile.values.mean(axis=1) for _, tile in chosen.tiles()])
