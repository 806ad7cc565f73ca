"""The error of each row, estimated from how well it predicts frames that were held out of it.

A row solved without some of its frames mispredicts these by what it has wrong. Under random
patterns an error d of the row gives an error of the sample whose variance is that of the patterns'
values times ||d||^2. So the frames held out measure ||d|| itself, of a row from a few frames less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.camera_grid import mean_around

# One frame of eight is held out, but at least two; none of fewer than eight frames. Chosen by hand:
# the row should lose few frames, and one frame alone has no variance.
EVERY = 8
FEWEST = 8
# Sides of the squares of camera pixels that errors are averaged over, as they are smooth over the
# camera: where every pixel or every second one is known, and in proportion where fewer are. A wider
# square stands in where a narrower one knows nothing.
SQUARES = (3, 9, 27)
# The noise of the camera is at most this quantile of the misfits under the frames that rows were
# solved with: most rows explain these but for noise. At least the second share of a misfit under
# the frames held out counts as error. Chosen on 100 small captures (benchmarks/honesty.py).
QUIET = 0.25
LEAST_SHARE = 0.1


def held_out_frames(count: int) -> NDArray[np.int64]:
    """The frames that are held out, evenly spread; none of fewer than `FEWEST` frames."""
    if count < FEWEST:
        return np.zeros(0, np.int64)
    held = max(2, count // EVERY)
    return ((np.arange(held) + 0.5) * count / held).astype(np.int64)


def without(samples: Samples, held: NDArray[np.int64]) -> Samples:
    """The samples with those of the frames held out masked."""
    weights = samples.weights_of_all()
    weights[:, held] = 0
    return Samples(samples.values, samples.clipped, samples.clip_level, weights)


def squared_misfit(
    samples: Samples, predicted: NDArray[np.float32], held: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Variance of each row's misfit at the H frames `held`, (M,); NaN where fewer than 2 count."""
    off = samples.values[:, held] - predicted
    weights = samples.weights_of_all()[:, held]
    # A clipped sample that is predicted beyond its bound says nothing about the error.
    weights[samples.clipped[:, held] & (off <= 0)] = 0
    total = weights.sum(axis=1)
    # The mean misfit is the error of the background and does not count. `number` is the effective
    # number of samples.
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (weights * off).sum(axis=1) / total
        number = total**2 / (weights**2).sum(axis=1)
        spread = (weights * (off - mean[:, None]) ** 2).sum(axis=1) / total
        spread *= number / np.maximum(number - 1, 0.5)
    # One sample is its own mean. Its number may differ from 1 by rounding.
    return np.where(number > 1.001, spread, np.nan).astype(np.float32)


def noise_of(residuals: NDArray[np.float32]) -> float:
    """The variance of the camera's noise by the residuals of some rows; those not known are NaN."""
    known = residuals[np.isfinite(residuals)]
    return float(np.quantile(known, QUIET)) if len(known) else 0.0


def held_out_energy(
    samples: Samples, predicted: NDArray[np.float32], held: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean squares of each row's misses at the frames `held`, and of its samples there, (M,)."""
    values = samples.values[:, held]
    off = values - predicted
    weights = (samples.weights_of_all()[:, held] > 0).astype(np.float32)
    # Samples that clip, and are predicted beyond their bound, are right.
    off[samples.clipped[:, held] & (off <= 0)] = 0
    total = np.maximum(weights.sum(axis=1), 1)
    return (weights * off**2).sum(axis=1) / total, (weights * values**2).sum(axis=1) / total


def smooth_misfit(
    squares: NDArray[np.float32], camera: tuple[int, int, int], noise: float, spacing: int = 1
) -> NDArray[np.float32]:
    """Misfits averaged over neighbouring camera pixels, less the camera's noise, (M,).

    They are known at every `spacing`-th camera pixel at most.
    """
    image = squares.reshape(camera).astype(np.float64)
    known = np.isfinite(image)
    means = np.full(camera, np.nan)
    if not known.any():
        return np.asarray(means.ravel(), np.float32)
    for width in SQUARES:
        missing = ~np.isfinite(means)
        if missing.any():
            side = 1 + (width - 1) * max(1, spacing // 2)
            means[missing] = mean_around(image, known, side)[missing]
    return np.asarray(np.maximum(means - noise, LEAST_SHARE * means).ravel(), np.float32)
