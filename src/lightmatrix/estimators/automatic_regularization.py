"""The regularization that an estimate chooses from its capture."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.patterns.pattern_set import PatternSet

# The regularization is at least this share of the clip level, for the weak tail of real rows. On
# rendered scenes (128 x 128, 64 to 1,024 patterns) errors rise slowly above it and hardly fall
# below.
TAIL_SHARE = 0.16
# It is also at least this share of the noise's universal threshold. Below it rows fill with noise,
# solving takes ten to a hundred times as long, and the estimate gets no better.
NOISE_SHARE = 0.75


def default_regularization(patterns: PatternSet, clip_level: float, noise: float) -> float:
    """The paper's lambda in units of camera sample, from what is known of patterns and sensor.

    It is the larger of `TAIL_SHARE` times `clip_level` (or the level that samples reach, if lower)
    and `NOISE_SHARE` times the universal threshold sigma |column| sqrt(2 ln N) (Donoho & Johnstone
    1994; for l1, Chen, Donoho & Saunders 1998), which `noise` sigma makes the correlation of some
    dark pixel reach. |column| is the length of a centred column.
    """
    threshold = noise * column_length(patterns) * np.sqrt(2 * np.log(max(patterns.pixels, 2)))
    return float(max(TAIL_SHARE * clip_level, NOISE_SHARE * threshold))


def column_length(patterns: PatternSet) -> float:
    """The root mean square length of the columns of P, with the patterns' means subtracted."""
    squares = sum(
        float(np.square(chunk, dtype=np.float64).sum()) / patterns.pixels
        for _, chunk in patterns.chunks()
    )
    return float(np.sqrt(max(squares - float((patterns.means**2).sum()), 0.0)))


# The regularization is chosen from 32 stretches of 64 rows, spread evenly over the capture. The
# values are chosen by hand: 2,048 rows suffice for a 0.99 quantile and are read in an instant.
_STRETCHES, _STRETCH = 32, 64


def reached_level(capture: Capture) -> float:
    """The level that samples reach at exposure 1, at most that at which the longest frames clip.

    It is a quantile over camera samples of the largest value under any pattern. Estimates scale
    with their samples only if the regularization does.
    """
    values, weights = spread_samples(capture)
    largest = np.where(weights > 0, values, 0).max(axis=1, initial=0)
    # Glints and hot pixels may be brighter than this quantile. Chosen by hand.
    return float(min(np.quantile(largest, 0.99), capture.reference_level))


# The regularization of total variation is this share of the noise's universal threshold. With twice
# this share, T errs in `benchmarks.buckets` by up to 8 % less at a usual camera's noise, and by up
# to 12 % more at a tenth of it.
VARIATION_SHARE = 0.05


def automatic_regularization(capture: Capture, *, pictures: bool = False) -> float:
    """The paper's lambda for this level and a usual camera's noise, in samples at exposure 1.

    With `pictures`, that of total variation, which follows the noise alone.
    """
    noise = USUAL_NOISE * capture.reference_level
    if pictures:
        share = VARIATION_SHARE / NOISE_SHARE
        return share * default_regularization(capture.patterns, 0.0, noise)
    level = max(reached_level(capture), noise)
    return default_regularization(capture.patterns, level, noise)


def spread_samples(capture: Capture) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values and weights of some rows, (m, K) each."""
    count = capture.rows
    if count <= _STRETCHES * _STRETCH:
        starts = np.arange(0, count, _STRETCH)
    else:
        starts = np.linspace(0, count - _STRETCH, _STRETCHES).astype(np.int64)
    parts = [capture.samples(int(s), min(int(s) + _STRETCH, count)) for s in starts]
    some = Samples.joined(parts)
    return some.values, some.weights_of_all()
