"""What a grey camera would have seen: samples under the pattern of each primary by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import KnownSamples
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.colour.mixing import PRIMARIES, ColourSamples
from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

# What keeps the inverse of a mixing regular, relative to gains of about 1. The weight of primaries
# that a pixel hardly sees is then nearly 0.
_LEAST_GAIN = 1e-4
# A level that no sample reaches.
_NEVER = np.float32(1e9)


def grey_capture(
    samples: ColourSamples, camera_shape: tuple[int, ...], exposure: float
) -> KnownSamples:
    """The grey photographs as those of a grey camera: the means of the three channels."""
    chosen = np.flatnonzero(samples.patterns.grey)
    equal = np.full((samples.pixels, PRIMARIES), 1 / PRIMARIES)
    known = _grey_samples(samples, equal, chosen)
    return KnownSamples.of(samples.patterns.red.subset(chosen), known, camera_shape, exposure)


def unmixed_capture(
    samples: ColourSamples,
    gains: NDArray[np.float64],
    camera_shape: tuple[int, ...],
    exposure: float,
) -> KnownSamples:
    """The photographs as those of a grey camera under grey patterns, one for each primary.

    A grey photograph stays one, with less noise. Where the gains (n, 3, 3) hardly tell a primary
    from the others, its noise is large, and its weight low in proportion.
    """
    grey, coloured = (
        np.flatnonzero(which) for which in (samples.patterns.grey, ~samples.patterns.grey)
    )
    white = gains.sum(axis=2)
    white /= np.maximum((white**2).sum(axis=1, keepdims=True), _LEAST_GAIN)
    parts = [_separated_samples(samples, gains, coloured)]
    if len(grey):
        parts.insert(0, _grey_samples(samples, white, grey))
    known = Samples(
        *(
            np.concatenate([getattr(part, name) for part in parts], axis=1)
            for name in ("values", "clipped", "clip_level", "weights")
        )
    )
    patterns = _grey_patterns(samples.patterns, grey, coloured)
    return KnownSamples.of(patterns, known, camera_shape, exposure)


def _grey_samples(
    samples: ColourSamples, shares: NDArray[np.float64], frames: NDArray[np.int64]
) -> Samples:
    """Sums of the three channels with shares (n, 3); of clipped ones a lower bound."""
    values = np.einsum("na,nak->nk", shares, samples.values[..., frames], optimize=True)
    clipped = np.any(samples.clipped[..., frames], axis=1)
    return _bounded(values, np.asarray(clipped), samples.weights[..., frames].min(axis=1))


def _separated_samples(
    samples: ColourSamples, gains: NDArray[np.float64], frames: NDArray[np.int64]
) -> Samples:
    """The light of red, then green, then blue in some frames, (n, 3 K).

    More light in a clipped channel would mean more of the primary that it sees most, and less of
    the others: of the first there is a lower bound, the others are left out.
    """
    count = samples.pixels
    inverse = np.linalg.inv(gains + _LEAST_GAIN * np.eye(PRIMARIES))
    values = np.einsum("nba,nak->nbk", inverse, samples.values[..., frames], optimize=True)
    hidden = samples.clipped[..., frames]
    falls = np.einsum("nba,nak->nbk", inverse < 0, hidden, optimize=True)
    clipped = np.broadcast_to(np.any(hidden, axis=1, keepdims=True), values.shape)
    noise = np.maximum((inverse**2).sum(axis=2), 1)[..., None]
    weights = samples.weights[..., frames].min(axis=1)[:, None] / noise * ~falls
    flat = (count, -1)
    return _bounded(values.reshape(flat), (clipped & ~falls).reshape(flat), weights.reshape(flat))


def _bounded(
    values: NDArray[np.floating], clipped: NDArray[np.bool_], weights: NDArray[np.floating]
) -> Samples:
    """Samples whose clipped ones are at their clip level, as lower bounds are."""
    single = values.astype(np.float32)
    levels = np.where(clipped, single, _NEVER)
    return Samples(single, clipped, levels, weights.astype(np.float32))


def _grey_patterns(
    patterns: ColourPatterns, grey: NDArray[np.int64], coloured: NDArray[np.int64]
) -> PatternSet:
    """The grey patterns, then those of red, green and blue in the others."""
    parts = [one.subset(coloured) for one in patterns.primaries]
    if len(grey):
        parts.insert(0, patterns.red.subset(grey))
    bits = [part.as_bits() for part in parts]
    if all(each is not None for each in bits):
        whole = np.concatenate([each for each in bits if each is not None])
        return BitPatterns(patterns.primary_shape, whole)
    return ImagePatterns(np.concatenate([part.images() for part in parts]))
