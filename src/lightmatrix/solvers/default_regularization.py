"""A default for the regularization, from the patterns and the noise of the camera."""

from __future__ import annotations

import numpy as np

from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet

# Of the clip level: what the weak tail of rendered rows asks for, whatever the number of patterns.
TAIL_SHARE = 0.16
# Of the universal threshold of the noise.
NOISE_SHARE = 0.75


def default_regularization(
    patterns: PatternSet, clip_level: float, noise: float | None = None
) -> float:
    """The regularization to use when nothing is known but the patterns and the sensor.

    The larger of two amounts. Noise of standard deviation sigma makes the correlation of some
    dark pixel's column exceed sigma * |column| * sqrt(2 ln N), the universal threshold (Donoho &
    Johnstone 1994; for l1 minimisation Chen, Donoho & Saunders 1998): below about three quarters
    of it rows fill with noise, solving becomes ten to a hundred times as dear, and the estimate no
    better. Above it, what cannot be explained by few pixels, the weak tail of real rows, decides:
    on rendered scenes (128 x 128, 64 to 1,024 patterns) errors rise from 0.16 clip levels on,
    slowly, and hardly fall below. |column| is the column's length once the background has taken
    its mean: sqrt(K) / 2 for fair coins.

    Parameters
    ----------
    patterns : PatternSet
        K patterns over N projector pixels.
    clip_level : float
        Y, in the units of the samples; > 0. If samples stay below it, the level that they reach.
    noise : float, optional
        Standard deviation of a sample, in the units of the samples; >= 0. None: 0.003 Y.

    Returns
    -------
    float
        The paper's lambda, in units of camera sample.

    Raises
    ------
    InputError
        On a clip level or a noise out of range.
    """
    if not (np.isfinite(clip_level) and clip_level > 0):
        raise InputError(f"a clip level of {clip_level}", hint="it is a positive camera sample")
    if noise is not None and not (np.isfinite(noise) and noise >= 0):
        raise InputError(f"a noise of {noise}", hint="it is a standard deviation, 0 or more")
    sigma = USUAL_NOISE * clip_level if noise is None else noise
    threshold = sigma * column_length(patterns) * np.sqrt(2 * np.log(max(patterns.pixels, 2)))
    return float(max(TAIL_SHARE * clip_level, NOISE_SHARE * threshold))


def column_length(patterns: PatternSet) -> float:
    """Root mean square length of the columns of P less the patterns' means."""
    squares = sum(
        float(np.square(chunk, dtype=np.float64).sum()) / patterns.pixels
        for _, chunk in patterns.chunks()
    )
    return float(np.sqrt(max(squares - float((patterns.means**2).sum()), 0.0)))
