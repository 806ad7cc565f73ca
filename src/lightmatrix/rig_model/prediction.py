"""What T predicts for camera samples, and what the strongest entries of T may have swallowed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.matrix import LightTransport

Array = NDArray[np.float64]

# Camera pixels around each patch, whose prediction tells how an image changes when it moves. The
# border of a patch changes the splines five pixels within by a thousandth.
MARGIN = 7
# Images (n, rows, cols, ...) without their margins.
INNER = (slice(None), slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
# Samples of the regression: ten thousand rows of 32 patterns. Twice as many change the
# numbers of the faults in the third digit.
_SAMPLES = 320_000


@dataclass(frozen=True, eq=False)
class Prediction:
    """m camera samples under K patterns.

    Parameters
    ----------
    capture : Capture
        Where the samples are from, corrected as far as faults are known.
    sent : Capture
        The capture before any correction, with the patterns as they were sent.
    transport : LightTransport
        The T that was estimated of `capture`.
    """

    capture: Capture
    sent: Capture
    transport: LightTransport
    # Rows of T of patches with margins, (patches, rows, cols, channels); which samples of the inner
    # ones count, flat; their samples, and their T p.
    places: NDArray[np.int64]
    chosen: NDArray[np.int64]
    samples: Samples
    around: Array
    # An orthonormal basis of what T may hold wrongly in each row, (m, d, K): the columns of its
    # strongest pixels, a constant, and T p itself, since an l1 estimate is too dark as a whole.
    basis: Array
    # Samples that count and do not clip, (m, K); how many of a row are left beside its basis, (m,).
    usable: NDArray[np.bool_]
    free: NDArray[np.int64]
    # The constant that least squares find in each row beside the rest of the basis, and the
    # variance that noise of one gives it, (2, m).
    constants: Array
    # What T p misses, without what the basis explains, (m, K).
    left: Array = field(init=False)

    def __post_init__(self) -> None:
        left = self.projected(self.samples.values - self.predicted)
        object.__setattr__(self, "left", left)

    @classmethod
    def of(cls, capture: Capture, sent: Capture, transport: LightTransport) -> "Prediction":
        """The prediction of rows of patches that are spread over the whole camera."""
        places = _patches(capture.camera_shape, _SAMPLES // capture.count)
        inner = places[INNER].reshape(-1)
        samples = samples_of_rows(capture, inner)
        spread = np.where(samples.counted, samples.values, 0).std(axis=1)
        usable = capture.valid[inner] & (samples.clipped.mean(axis=1) <= 0.3) & (spread > 0)
        # Rows that hardly vary hold little but noise.
        if usable.any():
            usable &= spread > 0.1 * np.quantile(spread[usable], 0.9)
        chosen = np.flatnonzero(usable)
        samples = samples.rows(chosen)
        around = predicted_light(transport, places.reshape(-1), capture.patterns)
        around = around.reshape(*places.shape, capture.count)
        counted = samples.counted & ~samples.clipped
        # The strongest projector pixels of each row, one for five frames, at most six.
        count, sparse = max(1, min(6, capture.count // 5)), transport.sparse[inner[chosen]]
        owner = np.repeat(np.arange(len(chosen)), np.diff(sparse.indptr))
        ordered = sparse.indices[np.lexsort((-sparse.data, owner))]
        firsts = sparse.indptr[:-1, None] + np.arange(count)
        ordered = np.append(ordered, np.zeros(count, np.int64))
        pixels = np.where(firsts < sparse.indptr[1:, None], ordered[firsts], 0)
        lit = np.moveaxis(capture.patterns.at(pixels), 0, 1).astype(np.float64)
        whole = around[INNER].reshape(-1, capture.count)[chosen]
        columns = np.concatenate([lit, np.ones_like(lit[..., :1])], axis=2) * counted[..., None]
        basis, strength, parts = np.linalg.svd(columns, full_matrices=False)
        # Weaker directions are rounding errors of columns that depend on each other.
        strong = strength > 1e-6 * np.maximum(strength[:, :1], 1e-12)
        basis = (basis * strong[:, None, :]).transpose(0, 2, 1)
        along = parts[:, :, -1] * strong / np.maximum(strength, 1e-12)
        constant = (along * np.einsum("mdk,mk->md", basis, samples.values * counted)).sum(axis=1)
        constants = np.stack([constant, (along**2).sum(axis=1)])
        rest = whole * counted
        size = np.linalg.norm(rest, axis=1, keepdims=True)
        rest -= np.einsum("mdk,md->mk", basis, np.einsum("mdk,mk->md", basis, rest))
        length = np.linalg.norm(rest, axis=1, keepdims=True)
        rest = np.where(length > 1e-6 * size, rest / np.maximum(length, 1e-300), 0)
        basis = np.concatenate([basis, rest[:, None]], axis=1)
        free = counted.sum(axis=1) - strong.sum(axis=1) - rest.any(axis=1)
        parts_of = places, chosen, samples, around, basis, counted, free, constants
        return cls(capture, sent, transport, *parts_of)

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.capture.count

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """The row of T of each sample, (m,)."""
        return self.places[INNER].reshape(-1)[self.chosen]

    @cached_property
    def slopes(self) -> Array:
        """Derivatives of T p where the samples lie, down and to the right, (2, m, K)."""
        return np.stack([self.inner(each) for each in slopes(self.around)[0]])

    @cached_property
    def predicted(self) -> Array:
        """T p of the samples, (m, K)."""
        return self.inner(self.around[INNER])

    @cached_property
    def position(self) -> Array:
        """Row and column of each sample in the camera, from 0 to 1, (2, m, 1)."""
        rows, cols = self.capture.camera_shape[:2]
        channels = int(np.prod(self.capture.camera_shape[2:]))
        row, col = np.divmod(self.rows // channels, cols)
        return np.stack([(row + 0.5) / rows, (col + 0.5) / cols])[:, :, None]

    def inner(self, images: Array) -> Array:
        """The samples (m, ...) of images of the patches without margins."""
        return images.reshape(-1, *images.shape[4:])[self.chosen]

    def under(self, change: Callable[[Array, Array], Array]) -> Array:
        """T applied to a change of the patterns as they were sent, (m, K)."""
        return predicted_light(self.transport, self.rows, self.sent.patterns, change)

    def projected(self, values: Array) -> Array:
        """What the basis of each row cannot explain of values (m, K)."""
        masked = values * self.usable
        inside = np.einsum("mdk,mk->md", self.basis, masked)
        return np.asarray((masked - np.einsum("mdk,md->mk", self.basis, inside)) * self.usable)


def predicted_light(
    transport: LightTransport,
    rows: NDArray[np.integer] | slice,
    patterns: PatternSet,
    change: Callable[[Array, Array], Array] | None = None,
) -> Array:
    """T p of some rows under K patterns, or under a change of them, (m, K)."""
    sparse, background = transport.sparse[rows], transport.background[rows]
    light = np.empty((sparse.shape[0], patterns.count))
    # The patterns at the pixels that these rows see.
    used, place = np.unique(sparse.indices, return_inverse=True)
    sparse = csr_array((sparse.data, place, sparse.indptr), (sparse.shape[0], len(used)))
    before = patterns.images(0, 1)
    for start, chunk in patterns.chunks():
        images = chunk.reshape(-1, *patterns.shape)
        if change is not None:
            earlier = np.concatenate([before, images[:-1]])
            before, images = images[-1:], change(images, earlier)
        shown = images.reshape(len(images), -1)
        light[:, start : start + len(chunk)] = sparse @ shown[:, used].T
        light[:, start : start + len(chunk)] += background @ (transport.pooling @ shown.T)
    return light


def slopes(images: Array) -> tuple[Array, Array]:
    """First and second derivatives of images (n, rows, cols, ...), (2, ...) each: down and right.

    Their margins are cut off. Cubic splines tell what lies between the pixels.
    """
    first, second = [], []
    for axis in (1, 2):
        other = np.take(images, np.arange(MARGIN, images.shape[3 - axis] - MARGIN), 3 - axis)
        before, here, after = _coefficients(other, axis, 1)
        first.append((after - before) / 2)
        second.append(after - 2 * here + before)
    return np.stack(first), np.stack(second)


def displaced(images: NDArray[Any], shift: Array) -> NDArray[Any]:
    """Images (n, rows, cols, channels, K), each moved by up to a pixel (down, right), (2, K).

    Their margins are cut off.
    """
    for axis, step in zip((1, 2), np.clip(shift, -1, 1), strict=True):
        # `at` says where the place lies between two pixels; four splines reach it.
        later = step < 0
        at = np.where(later, -step, 1 - step)
        splines = (1 - at) ** 3, 3 * at**3 - 6 * at**2 + 4, 1 + 3 * at * (1 + at - at**2), at**3
        weights = np.zeros((5, len(step)), images.dtype)
        for number, weight in enumerate(splines):
            weights[number + later, np.arange(len(step))] = weight / 6
        parts = _coefficients(images, axis, 2)
        images = sum(weight * part for weight, part in zip(weights, parts, strict=True))
    return np.asarray(images)


def _coefficients(images: NDArray[Any], axis: int, reach: int) -> list[NDArray[Any]]:
    """Coefficients of splines through images, up to `reach` before and after each inner place."""
    coefficients = scipy.ndimage.spline_filter1d(images, 3, axis, images.dtype, "mirror")
    length = images.shape[axis] - 2 * MARGIN
    starts = range(MARGIN - reach, MARGIN + reach + 1)
    return [np.take(coefficients, np.arange(start, start + length), axis) for start in starts]


def samples_of_rows(capture: Capture, rows: NDArray[np.int64]) -> Samples:
    """The samples of some rows of a capture, in their order; rows far from all are not read."""
    order = np.argsort(rows)
    runs = np.split(order, np.flatnonzero(np.diff(rows[order]) > 256) + 1)
    firsts = [int(rows[run[0]]) for run in runs]
    parts = [
        capture.samples(first, int(rows[run[-1]]) + 1).rows(rows[run] - first)
        for first, run in zip(firsts, runs, strict=True)
    ]
    return Samples.joined(parts).rows(np.argsort(order))


def _patches(camera: tuple[int, ...], most: int) -> NDArray[np.int64]:
    """Rows of T in patches with margins, (patches, rows, cols, channels), all over the camera."""
    rows, cols, channels = *camera[:2], int(np.prod(camera[2:]))
    side = 24
    height, width = min(rows, side), min(cols, side)
    count = max(1, most // (height * width * channels))
    down = max(1, min(-(-rows // height), round(np.sqrt(count * rows / cols))))
    right = max(1, min(-(-cols // width), -(-count // down)))
    if rows * cols * channels <= most:
        down, right, height, width = 1, 1, rows, cols
    tops = np.linspace(0, rows - height, down).astype(int)
    lefts = np.linspace(0, cols - width, right).astype(int)
    around = np.arange(-MARGIN, height + MARGIN), np.arange(-MARGIN, width + MARGIN)
    patches = []
    for top in tops:
        for left in lefts:
            row = np.clip(top + around[0], 0, rows - 1)[:, None, None]
            col = np.clip(left + around[1], 0, cols - 1)[None, :, None]
            patches.append((row * cols + col) * channels + np.arange(channels))
    return np.stack(patches)
