"""Which projector pixel along an axis each camera pixel sees, from its samples under the code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposures import USUAL_NOISE
from lightmatrix.decoding.codes import Code

# Correlations of camera pixels with projector pixels that are computed at a time: 64 MB, which a
# matrix product fills fast and the search of its largest values then finds in the cache or near it.
_CORRELATIONS = 1 << 24
# The least variance of a word, so that a constant one divides nothing by 0: it has no light.
_CONSTANT = 1e-12


@dataclass(frozen=True, eq=False)
class Reading:
    """What m camera pixels see along one axis.

    Parameters
    ----------
    pixel : (m,) int64
        The projector pixel; -1 where the samples are no word of the code.
    place : (m,) float64
        The same to fractions of a pixel.
    light : (m,) float64
        The direct light: how much brighter a lit projector pixel makes the camera pixel than a dark
        one, in units of the clip level.
    explained : (m,) float64
        Share of the samples' variance that the code explains, in [0, 1].
    uncertainty : (m,) float64
        Standard deviation of the place, in projector pixels.
    """

    pixel: NDArray[np.int64]
    place: NDArray[np.float64]
    light: NDArray[np.float64]
    explained: NDArray[np.float64]
    uncertainty: NDArray[np.float64]


def read_bits(
    code: Code, samples: NDArray[np.float32], middle: NDArray[np.float32]
) -> NDArray[np.int64]:
    """The projector pixel of each camera pixel by the bits of its samples (m, k); -1 for none.

    The brighter of a pattern and its inverse decides a bit; without inverse, whether the sample is
    above `middle`, (m,), half way from black to white.
    """
    word = np.zeros(len(samples), np.int64)
    for place, (frame, inverse) in enumerate(code.bits):
        threshold = middle if inverse < 0 else samples[:, inverse]
        word |= (samples[:, frame] > threshold).astype(np.int64) << place
    words, pixels = code.words
    found = np.minimum(np.searchsorted(words, word), len(words) - 1)
    return np.where(words[found] == word, pixels[found], -1)


def correlate(code: Code, samples: NDArray[np.float32]) -> NDArray[np.int64]:
    """The projector pixel whose values correlate best with each camera pixel's samples (m, k).

    The most likely one under noise that is the same in all samples, whatever the surface and the
    constant light (Mirdehghan et al. 2018). Places half way between two pixels are tried too: few
    patterns of short periods resemble them elsewhere better than in their neighbours.
    """
    centred = np.empty((2 * code.length - 1, samples.shape[1]), np.float32)
    centred[::2] = code.centred
    centred[1::2] = (code.centred[1:] + code.centred[:-1]) / 2
    length = np.sqrt((centred**2).sum(axis=1, keepdims=True))
    directions = np.ascontiguousarray((centred / np.maximum(length, 1e-12)).T)
    pixel = np.empty(len(samples), np.int64)
    step = max(1, _CORRELATIONS // len(centred))
    for start in range(0, len(samples), step):
        part = samples[start : start + step]
        # Columns of `directions` sum to 0, so that the mean of the samples does not matter.
        pixel[start : start + step] = (part @ directions).argmax(axis=1) // 2
    return pixel


def refine(code: Code, samples: NDArray[np.float32], pixel: NDArray[np.int64]) -> Reading:
    """The place to fractions of a pixel, and how well the code fits the samples (m, k).

    A camera pixel that sees parts of two neighbouring projector pixels has samples that are a
    mixture of their values: least squares gives the shares (and the constant light).
    """
    k = samples.shape[1]
    known = np.maximum(pixel, 0)
    centred = code.centred
    own = samples - samples.mean(axis=1, keepdims=True)
    energy = np.einsum("ij,ij->i", own, own).astype(np.float64)
    square = np.maximum((centred.astype(np.float64) ** 2).sum(axis=1), _CONSTANT)
    product = (centred[:-1].astype(np.float64) * centred[1:]).sum(axis=1)
    here = np.einsum("ij,ij->i", own, centred[known]).astype(np.float64)
    light = here / square[known]
    fit = light * here
    offset = np.zeros(len(pixel))
    for side in (-1, 1):
        other = np.clip(known + side, 0, code.length - 1)
        there = np.einsum("ij,ij->i", own, centred[other]).astype(np.float64)
        cross = product[np.minimum(np.minimum(known, other), len(product) - 1)]
        determinant = square[known] * square[other] - cross**2
        with np.errstate(invalid="ignore", divide="ignore"):
            first = (square[other] * here - cross * there) / determinant
            second = (square[known] * there - cross * here) / determinant
            share = second / (first + second)
        mixed = (other != known) & (second > 0) & (first > 0)
        offset += np.where(mixed, side * share, 0)
        better = mixed & (first * here + second * there > fit)
        light = np.where(better, first + second, light)
        fit = np.where(better, first * here + second * there, fit)
    noise = np.sqrt(np.maximum(energy - fit, 0) / max(1, k - 3))
    slope = _slopes(centred)[known] * np.maximum(light, 1e-12)
    return Reading(
        pixel,
        np.where(pixel >= 0, pixel + offset, np.nan),
        light,
        np.clip(fit / np.maximum(energy, 1e-30), 0, 1),
        np.maximum(noise, USUAL_NOISE) / slope,
    )


def _slopes(centred: NDArray[np.float32]) -> NDArray[np.float64]:
    """How far the values move per projector pixel, (length,)."""
    moved = np.gradient(centred.astype(np.float64), axis=0)
    return np.asarray(np.maximum(np.sqrt((moved**2).sum(axis=1)), 1e-6))
