"""How much of each primary's light reaches each channel of a camera pixel: the gains M."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.files.colours import COLOURS
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.transport.matrix import LightTransport

PRIMARIES = len(COLOURS)
# The mixing before any is measured: filters that pass a quarter of the next primary's light, and a
# tenth of that after it. Chosen by hand. It needs not be right: the geometry that it gives is a
# first guess.
USUAL_MIXING = np.array([[1.0, 0.25, 0.1], [0.25, 1.0, 0.25], [0.1, 0.25, 1.0]])
# Gains are scaled so that the mean channel sees all of a white pattern's light.
_WHITE = float(PRIMARIES)
# Relative size of what keeps a system of equations regular.
_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class ColourSamples:
    """Samples of n camera pixels in three channels under K patterns of a colour projector."""

    patterns: ColourPatterns
    # Linear samples (n, 3, K), which of them are clipped, and their weights.
    values: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, samples: Samples, patterns: ColourPatterns) -> ColourSamples:
        """The samples of all rows of a capture."""
        shape = (-1, PRIMARIES, patterns.count)
        weights = samples.weights_of_all().astype(np.float32).reshape(shape)
        values = np.asarray(samples.values, np.float32).reshape(shape)
        return cls(patterns, values, samples.clipped.reshape(shape), weights)

    @property
    def pixels(self) -> int:
        """Number of camera pixels n."""
        return len(self.values)


def light_of_primaries(geometry: LightTransport, patterns: ColourPatterns) -> NDArray[np.float32]:
    """What a grey camera would see of each primary's pattern, G p, (n, 3, K)."""
    light = [geometry.multiplied(one.dense().T) for one in patterns.primaries]
    return np.stack(light, axis=1).astype(np.float32)


def usual_gains(pixels: int) -> NDArray[np.float64]:
    """The usual mixing for all camera pixels, (n, 3, 3)."""
    usual = USUAL_MIXING * (_WHITE / USUAL_MIXING.sum())
    return np.broadcast_to(usual, (pixels, *usual.shape))


def fit_gains(
    samples: ColourSamples, light: NDArray[np.float32], trust: float
) -> NDArray[np.float64]:
    """The gains (n, 3, 3) of channel by primary that explain the samples best.

    The least-squares gains of each channel are drawn to the mixing of the whole frame, times one
    factor for the channel: `trust` is the weight of this expectation relative to the samples. They
    are not negative, and scaled so that the mean channel sees all light of white.
    """
    known = samples.weights * ~samples.clipped
    gram = np.einsum("nbk,nck,nak->nabc", light, light, known, optimize=True).astype(float)
    right = np.einsum("nbk,nak->nab", light, known * samples.values, optimize=True).astype(float)
    scale = np.trace(gram, axis1=2, axis2=3)[..., None, None] / PRIMARIES
    eye = np.eye(PRIMARIES)
    first = _solved(gram + (_TINY + scale * _TINY) * eye, right)
    mixing = _of_frame(first, samples.values.mean(axis=2).sum(axis=1))
    # How strongly the channel sees light of the frame's mixing.
    energy = np.einsum("nabc,ab,ac->na", gram, mixing, mixing)
    factor = np.einsum("nab,ab->na", right, mixing) / np.maximum(energy, 1e-30)
    expected = np.maximum(factor, 0)[..., None] * mixing
    drawn = _solved(gram + (_TINY + trust * scale) * eye, right + trust * scale[..., 0] * expected)
    gains = np.maximum(drawn, 0)
    total = gains.sum(axis=(1, 2), keepdims=True)
    usual = usual_gains(len(gains))
    return np.where(total > 0, gains * (_WHITE / np.where(total > 0, total, 1)), usual)


def _solved(matrices: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])


def _of_frame(gains: NDArray[np.float64], light: NDArray[np.float32]) -> NDArray[np.float64]:
    """The median share of each primary in what a channel sees, (3, 3), over pixels with light."""
    # Pixels darker than this share of the mean say nothing of the frame's mixing. Chosen by hand.
    bright = light > 0.1 * light.mean()
    total = gains.sum(axis=2, keepdims=True)
    fine = bright[:, None] & (total[..., 0] > 0)
    shares = np.divide(gains, total, out=np.full_like(gains, np.nan), where=fine[..., None])
    if not fine.any(axis=0).all():
        return USUAL_MIXING / USUAL_MIXING.sum(axis=1, keepdims=True)
    return np.maximum(np.nanmedian(shares, axis=0), 0)
