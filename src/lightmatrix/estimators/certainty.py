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

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.coherent.neighbourhood import strongest_entries
from lightmatrix.patterns.pattern_set import NEAR, PatternSet
from lightmatrix.transport.sparse_rows import SparseRows

# The diagnostic: 1 where the strongest projector pixel is certain, 0 where it is not, NaN for rows
# that were not looked at.
CERTAIN = "certain"

Misfits = NDArray[np.float32]


def with_certainty(
    rows: SparseRows, samples: Samples, patterns: PatternSet, start: int, total: int,
    cell_means: NDArray[np.floating] | None = None,
) -> SparseRows:  # fmt: skip
    """Rows of T from row `start` on, of `total`, with the diagnostic `certain`.

    `cell_means` (B, K) are the means of the patterns over the cells of the rows' background. None:
    it has one cell.
    """
    # Rows of an estimate, evenly spread, that are looked at: 1,024, or as many as make 2^28 pairs
    # of a row and a projector pixel, but 256. Their share of certain rows has a standard error of
    # at most 1.6 %, or 3 % of 256 rows. Under 4K, 1,024 rows would take a minute of processor.
    step = max(1, total // min(1024, max(256, (1 << 28) // patterns.pixels)))
    index = np.arange(start, start + rows.count)
    chosen = np.flatnonzero(index % step == step // 2)
    certain = np.full(rows.count, np.nan, np.float32)
    means = patterns.means[None] if cell_means is None else cell_means
    # Two samples say nothing beside the strength of the light and the background.
    if len(chosen) and patterns.count > 2:
        some, seen = rows.rows(chosen), samples.rows(chosen)
        values = _direct_light(some, seen, patterns, means)
        lit = np.flatnonzero(some.coefficients.max(axis=1).toarray().ravel() > 0)
        pixels = strongest_entries(some.coefficients)
        result = np.zeros(len(chosen), np.bool_)
        result[lit] = _probable(values[lit], pixels[lit], patterns)
        result[lit] |= _beyond_error(some.rows(lit), pixels[lit], patterns)
        certain[chosen] = result
    return replace(rows, diagnostics={**rows.diagnostics, CERTAIN: certain})


def _direct_light(
    rows: SparseRows, samples: Samples, patterns: PatternSet, cell_means: NDArray[np.floating]
) -> NDArray[np.float64]:
    """The samples less the diffuse light, (n, K).

    Where they are masked, or clipped below the predictions of T, these take their place.
    """
    used, place = np.unique(rows.coefficients.indices, return_inverse=True)
    matrix = rows.coefficients
    own = csr_array((matrix.data, place, matrix.indptr), shape=(rows.count, len(used)))
    predicted = own @ patterns.columns(used).T.astype(np.float64)
    diffuse = rows.background @ cell_means
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
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    # A row without contrast explains no pixel more than any other.
    rows = (values / np.where(lengths > 0, lengths, 1)).astype(np.float32)
    contrasts = patterns.contrasts
    inverse = np.zeros(patterns.pixels, np.float32)
    np.divide(1, contrasts, out=inverse, where=contrasts > 0, casting="same_kind")
    windows = _windows(pixels, patterns)

    def misfits(some: slice, part: slice, correlations: NDArray[np.float32]) -> Misfits:
        """The shares of the rows that each pixel alone leaves unexplained, not below the least."""
        np.maximum(correlations, 0, out=correlations)
        np.square(correlations, out=correlations)
        correlations *= -inverse[part]
        correlations += 1
        # The least share of a row that no single pixel explains: a noise of 1 % of the row's
        # contrast. It is a hundred times what single precision loses, and pixels that are not twins
        # differ by far more.
        return np.maximum(correlations, 1e-4, out=correlations)

    def least(some: slice, part: slice, correlations: NDArray[np.float32]) -> tuple[slice, Misfits]:
        return some, misfits(some, part, correlations).min(axis=1)

    best = np.ones(len(rows), np.float32)
    for some, found in patterns.correlations(rows, least):
        np.minimum(best[some], found, out=best[some])
    sharpness = np.float32((patterns.count - 2) / 2)

    def likelihoods(
        some: slice, part: slice, correlations: NDArray[np.float32]
    ) -> tuple[slice, NDArray[np.float64], NDArray[np.float64]]:
        """Sums over all pixels of a part, and over those in the rows' windows."""
        likely = misfits(some, part, correlations)
        likely *= (-sharpness / best[some])[:, None]
        likely += sharpness
        np.exp(likely, out=likely)
        near = windows[some] - part.start
        inside = (near >= 0) & (near < likely.shape[1])
        in_window = np.take_along_axis(likely, np.where(inside, near, 0), axis=1)
        return some, likely.sum(axis=1, dtype=np.float64), (in_window * inside).sum(axis=1)

    whole, near = np.zeros(len(rows)), np.zeros(len(rows))
    for some, of_all, of_window in patterns.correlations(rows, likelihoods):
        whole[some] += of_all
        near[some] += of_window
    # The least probability of a certain pixel: the usual level of confidence.
    return np.asarray(near >= 0.95 * whole)


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


def _windows(pixels: NDArray[np.int64], patterns: PatternSet) -> NDArray[np.int64]:
    """Each pixel and its neighbours, (n, d), -1 outside the projector.

    Where no pattern varies along columns or rows, whole ones are neighbours.
    """
    places = []
    for place, length, varies in zip(
        np.divmod(pixels, patterns.shape[1]), patterns.shape, patterns.axes, strict=True
    ):
        near = place[:, None] + np.arange(-NEAR, NEAR + 1)
        whole = np.broadcast_to(np.arange(length), (len(pixels), length))
        places.append(np.where((near >= 0) & (near < length), near, -1) if varies else whole)
    row, col = np.broadcast_arrays(places[0][:, :, None], places[1][:, None, :])
    numbers = np.where((row >= 0) & (col >= 0), row * patterns.shape[1] + col, -1)
    return np.asarray(numbers.reshape(len(pixels), row.shape[1] * row.shape[2]))
