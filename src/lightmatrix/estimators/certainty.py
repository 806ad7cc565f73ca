"""Whether the strongest projector pixel of a row is certain, given the photographs.

Each row is compared with every projector pixel alone, on top of an even background. With samples y
and the pattern values a_j of pixel j, both less their share in the background's column, pixel j
explains R_j^2 = <y, a_j>^2 / (|y|^2 |a_j|^2) of the row. Its probability is in proportion to
exp(-(1 - R_j^2) / 2 s^2), with the noise s^2 = (1 - R^2) / (K - 2) of the pixel that explains most.
A pixel is certain if it and its neighbours have nearly all of the probability. Twins, which all
patterns show alike, share it, so that neither is certain.

Neighbouring camera pixels know more together than one alone. So a pixel is certain, too, if the
row's estimated error is too small to raise another pixel above it, and the patterns do not show the
same surroundings elsewhere.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.twins import NEAR
from lightmatrix.resources.work_ahead import work_ahead
from lightmatrix.transport.matrix import cell_means
from lightmatrix.transport.sparse_rows import SparseRows

# The diagnostic: 1 where the strongest projector pixel is certain, 0 where it is not, NaN for rows
# that were not looked at.
CERTAIN = "certain"
# Rows of an estimate, evenly spread, that are looked at. Their share of certain rows has a standard
# error of at most 1.6 %.
SAMPLED = 1024
# The least probability of a certain pixel: the usual level of confidence.
_PROBABLE = 0.95
# The least share of a row that no single pixel explains, so that samples without noise divide
# nothing by zero. Far below the noise of any camera.
_LEAST_MISFIT = 1e-8
# Pixels that are less probable than the best one by a factor of exp(60) are not looked at: a
# billion of them together would change no probability.
_NEGLIGIBLE = 60.0
# Bytes of correlations of some rows with all projector pixels, of each thread. Chosen by hand, to
# lie far below the working memory of a tile.
_BYTES = 8 << 20


def with_certainty(
    rows: SparseRows,
    samples: Samples,
    patterns: PatternSet,
    background_grid: tuple[int, int],
    start: int,
    total: int,
) -> SparseRows:
    """Rows of T from row `start` on, of `total`, with the diagnostic `certain`."""
    step = max(1, total // SAMPLED)
    index = np.arange(start, start + rows.count)
    chosen = np.flatnonzero(index % step == step // 2)
    certain = np.full(rows.count, np.nan, np.float32)
    # Two samples say nothing beside the strength of the light and the background.
    if len(chosen) and patterns.count > 2:
        some, seen = rows.rows(chosen), samples.rows(chosen)
        values = _direct_light(some, seen, patterns, background_grid)
        pixels = _strongest(some.coefficients)
        lit = np.flatnonzero(pixels >= 0)
        result = np.zeros(len(chosen), np.bool_)
        result[lit] = _probable(values[lit], pixels[lit], patterns)
        result[lit] |= _beyond_error(some.rows(lit), pixels[lit], patterns)
        certain[chosen] = result
    return replace(rows, diagnostics={**rows.diagnostics, CERTAIN: certain})


def _direct_light(
    rows: SparseRows, samples: Samples, patterns: PatternSet, background_grid: tuple[int, int]
) -> NDArray[np.float64]:
    """The samples less the diffuse light, (n, K).

    Where they are masked, or clipped below the predictions of T, these take their place.
    """
    used, place = np.unique(rows.coefficients.indices, return_inverse=True)
    matrix = rows.coefficients
    own = csr_array((matrix.data, place, matrix.indptr), shape=(rows.count, len(used)))
    predicted = own @ patterns.columns(used).T.astype(np.float64)
    diffuse = np.empty_like(predicted)
    cells = cell_means(patterns.shape, background_grid)
    for start, chunk in patterns.chunks():
        diffuse[:, start : start + len(chunk)] = rows.background @ (cells @ chunk.T)
    predicted += diffuse
    values = samples.values.astype(np.float64)
    hidden = samples.weights_of_all() == 0
    known = np.where(hidden | (samples.clipped & (predicted > values)), predicted, values)
    return np.asarray(known - diffuse)


def _probable(
    values: NDArray[np.float64], pixels: NDArray[np.int64], patterns: PatternSet
) -> NDArray[np.bool_]:
    """Whether the photographs alone leave no doubt that each row sees its pixel most, (n,)."""
    column = patterns.means / max(float(np.linalg.norm(patterns.means)), 1e-300)
    values = values - np.outer(values @ column, column)
    lengths = np.square(values).sum(axis=1)
    contrasts = patterns.contrasts
    inverse = np.divide(1, contrasts, out=np.zeros_like(contrasts), where=contrasts > 0)
    together = max(1, _BYTES // (8 * patterns.pixels))

    def shares(first: int) -> list[float]:
        some = slice(first, first + together)
        explained = patterns.adjoint(values[some])
        np.maximum(explained, 0, out=explained)
        np.square(explained, out=explained)
        explained *= inverse
        return [
            _probability(
                parts.reshape(patterns.shape)[_window(int(pixel), patterns)].ravel(),
                parts,
                float(length),
                patterns.count,
            )
            for parts, length, pixel in zip(explained, lengths[some], pixels[some], strict=True)
        ]

    found = work_ahead(shares, range(0, len(values), together))
    return np.fromiter(chain.from_iterable(found), np.float64, len(values)) >= _PROBABLE


def _probability(
    window: NDArray[np.float64], explained: NDArray[np.float64], length: float, count: int
) -> float:
    """The probability of the pixels in a window, from the squares that each pixel explains.

    `length` is the squared length of the row of `count` samples.
    """
    # A row without contrast explains no pixel more than any other.
    length = length or 1.0
    best = max(1 - float(explained.max()) / length, _LEAST_MISFIT)
    sharpness = (count - 2) / 2

    def likely(parts: NDArray[np.float64]) -> float:
        misfit = np.maximum(1 - parts / length, _LEAST_MISFIT)
        return float(np.exp(sharpness * (1 - misfit / best)).sum())

    least = length * (1 - best * (1 + _NEGLIGIBLE / sharpness))
    return likely(window) / likely(explained[explained >= least])


def _beyond_error(
    rows: SparseRows, pixels: NDArray[np.int64], patterns: PatternSet
) -> NDArray[np.bool_]:
    """Whether the estimated error of each row is too small to raise a rival above its pixel."""
    errors = np.asarray(rows.diagnostics.get("estimated_error", np.full(rows.count, np.nan)))
    matrix = rows.coefficients
    result = np.zeros(rows.count, np.bool_)
    for row in np.flatnonzero(np.isfinite(errors) & ~patterns.alike_surroundings[pixels]):
        entries = slice(matrix.indptr[row], matrix.indptr[row + 1])
        light, index = matrix.data[entries].astype(np.float64), matrix.indices[entries]
        places, own = np.divmod(index, patterns.shape[1]), divmod(pixels[row], patterns.shape[1])
        far = np.zeros(len(index), np.bool_)
        for place, centre, varies in zip(places, own, patterns.axes, strict=True):
            far |= varies & (np.abs(place - centre) > NEAR)
        margin = light.max() - light[far].max(initial=0.0)
        # An error of this length in the two pixels makes them equal.
        result[row] = errors[row] * np.linalg.norm(light) < margin / np.sqrt(2)
    return result


def _window(pixel: int, patterns: PatternSet) -> tuple[slice, slice]:
    """A pixel and its neighbours; whole columns or rows if no pattern varies along them."""
    row, col = divmod(pixel, patterns.shape[1])
    along = [
        slice(max(0, place - NEAR), place + NEAR + 1) if varies else slice(None)
        for place, varies in zip((row, col), patterns.axes, strict=True)
    ]
    return along[0], along[1]


def _strongest(matrix: csr_array) -> NDArray[np.int64]:
    """The projector pixel that each row sees most, (n,); -1 where it sees none."""
    result = np.full(matrix.shape[0], -1, np.int64)
    for row in np.flatnonzero(np.diff(matrix.indptr)):
        entries = slice(matrix.indptr[row], matrix.indptr[row + 1])
        light = matrix.data[entries]
        if light.max() > 0:
            result[row] = matrix.indices[entries][light.argmax()]
    return result
