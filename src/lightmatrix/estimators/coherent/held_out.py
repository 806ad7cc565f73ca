"""How far a row is probably off: what it predicts for frames that were held out of it.

A row solved without some of its frames errs at them by what it has wrong. Under random patterns an
error d of the row gives an error of the sample whose variance is that of the patterns' values times
||d||^2: so the frames held out measure ||d|| itself, of a row from a few frames less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.pooling import mean_around

# One frame of so many is held out, but at least two; of fewer frames than this, none.
EVERY = 8
FEWEST = 8
# Errors are smooth over the camera: they are pooled over a window of so many pixels, or, where
# nothing is known within that, over a wider one.
POOLED = (3, 9, 27)
# The rows that err least show what is noise. No less than this share of what is seen is error.
DARKEST = 0.05
LEAST_SHARE = 0.1


def held_out_frames(count: int) -> NDArray[np.int64]:
    """Indices of the frames that are held out, evenly spread; none of fewer than `FEWEST`."""
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
    """Variance of each row's misfit at the frames held out, (M,); NaN where fewer than two count.

    Parameters
    ----------
    samples : Samples
        (M, K), all of them.
    predicted : (M, H) float32
        What the rows give under the H frames held out.
    held : (H,) int
    """
    off = samples.values[:, held] - predicted
    weights = samples.weights_of_all()[:, held]
    # A clipped sample that is predicted beyond its bound says nothing of the error.
    weights[samples.clipped[:, held] & (off <= 0)] = 0
    total = weights.sum(axis=1)
    # The effective number of samples; their mean, which is the background's error, does not count.
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (weights * off).sum(axis=1) / total
        number = total**2 / (weights**2).sum(axis=1)
        spread = (weights * (off - mean[:, None]) ** 2).sum(axis=1) / total
        spread *= number / np.maximum(number - 1, 0.5)
    # One sample is its own mean; its number is 1 but for rounding.
    return np.where(number > 1.001, spread, np.nan).astype(np.float32)


def pooled(squares: NDArray[np.float32], camera: tuple[int, int, int]) -> NDArray[np.float32]:
    """Means over the camera's neighbourhoods, without what is the camera's noise, (M,)."""
    image = squares.reshape(camera).astype(np.float64)
    known = np.isfinite(image)
    means = np.full(camera, np.nan)
    if not known.any():
        return np.asarray(means.ravel(), np.float32)
    for width in POOLED:
        missing = ~np.isfinite(means)
        if missing.any():
            means[missing] = mean_around(image, known, width)[missing]
    noise = np.quantile(image[known], DARKEST)
    return np.asarray(np.maximum(means - noise, LEAST_SHARE * means).ravel(), np.float32)
