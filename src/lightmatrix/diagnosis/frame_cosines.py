"""Standardised photographs and the cosines between patterns, which `relation.py` compares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.pattern_set import PatternSet

# Fewer camera pixels than these are not judged.
_FEWEST_ROWS = 40
# Rows count if their standard deviation exceeds 30 % of that of the most varied tenth.
_VARIED = 0.3
# Standard deviations of the blurs in projector pixels, and the cells along each side of the
# projector that a crop or a distant object may be confined to.
_BLURS, _CELLS = (0.0, 1.0, 2.0, 4.0, 8.0), (2, 4)
# The work is bounded: a projector is binned to at most 2^16 pixels, and at most 2^23 values of
# patterns and 2^22 samples of at most 128 frames are compared.
_MOST_PIXELS, MOST_VALUES, _MOST_SAMPLES = 1 << 16, 1 << 23, 1 << 22
MOST_FRAMES = 128
# Triple products of frames, which tell negatives, are formed at no more than this many pixels of
# the camera and of the projector.
MOST_PRODUCTS = 2048

Floats = NDArray[np.float32]


def counted_rows(survey: Survey) -> NDArray[np.bool_]:
    """Which samples vary enough to be compared, (S,)."""
    spread = survey.statistics.spread
    usable = survey.valid & (spread > 0)
    if usable.any():
        usable &= spread > _VARIED * np.quantile(spread[usable], 0.9)
    return usable


def standardised_frames(survey: Survey, count: int) -> tuple[Floats, NDArray[np.int64]] | None:
    """Frames with mean 0 and variance 1 at each pixel that counts, 0 at others.

    They are (rows, cols, channels, K) with the numbers of the rows in the frame. Large frames are
    thinned out so that a turned frame has the same pixels.
    """
    usable = counted_rows(survey)
    if usable.sum() < _FEWEST_ROWS:
        return None
    tiles, rows, cols, channels = survey.grid
    step = max(1, int(np.sqrt(usable.size * count / _MOST_SAMPLES)))
    down, right = _thinned(tiles * rows, step), _thinned(cols, step)
    index = np.arange(usable.size).reshape(tiles * rows, cols, channels)[np.ix_(down, right)]
    places = np.flatnonzero(usable[index.ravel()])
    if len(places) < _FEWEST_ROWS:
        return None
    images = np.zeros((index.size, count), np.float32)
    values = survey.samples(index.ravel()[places]).values[:, :count].astype(np.float32)
    values -= values.mean(axis=1, keepdims=True)
    spread = values.std(axis=1, keepdims=True)
    images[places] = values / np.maximum(spread, 1e-12) * (spread > 0)
    return images.reshape(*index.shape, count), down


def _thinned(length: int, step: int) -> NDArray[np.int64]:
    """Some of the numbers below `length`, a step apart, the same when counted backwards."""
    near = np.arange(0, (length + 1) // 2, step)
    return np.unique(np.concatenate([near, length - 1 - near]))


def binned_shape(patterns: PatternSet) -> tuple[int, int]:
    """The projector's shape after binning, of at most `_MOST_PIXELS`."""
    rows, cols = patterns.shape
    step = 1
    while True:
        shape = max(1, rows // step), max(1, cols // step)
        if shape[0] * shape[1] <= _MOST_PIXELS:
            return shape
        step *= 2


def pattern_images(patterns: PatternSet, count: int, shape: tuple[int, int]) -> Floats:
    """The first patterns, binned, (K, rows, cols)."""
    rows, cols = shape
    step = max(patterns.shape[0] // rows, 1), max(patterns.shape[1] // cols, 1)
    images = np.empty((count, rows, cols), np.float32)
    for k in range(count):
        image = patterns.images(k, k + 1)[0][: rows * step[0], : cols * step[1]]
        images[k] = image.reshape(rows, step[0], cols, step[1]).mean(axis=(1, 3))
    return images


def pattern_cosines(patterns: Floats) -> tuple[Floats, tuple[Floats, ...]]:
    """Cosines between patterns through blurs and in cells, and the blurred patterns."""
    count, rows, cols = patterns.shape
    grams, shown = [], []
    for blur in _BLURS:
        if blur > min(rows, cols) / 4:
            continue
        seen = _blurred(patterns, blur) if blur else patterns
        seen = seen - seen.mean(axis=0)
        flat = seen.reshape(count, -1)
        grams.append(flat @ flat.T)
        # A camera pixel is standardised whatever it sees; so are these.
        some = flat[:, np.random.default_rng(4).permutation(flat.shape[1])[:MOST_PRODUCTS]]
        shown.append((some / np.maximum(some.std(axis=0), 1e-6)).T)
        for cells in _CELLS if blur == 0 else _CELLS[:1] if blur == 2 else ():
            for part in np.array_split(seen, cells, axis=1):
                for cell in np.array_split(part, cells, axis=2):
                    flat = cell.reshape(count, -1)
                    grams.append(flat @ flat.T)
    mean = patterns.mean(axis=(1, 2))
    mean = mean - mean.mean()
    grams.append(np.outer(mean, mean))
    cosines = np.stack([each for gram in grams for each in cosines_of(gram)])
    off = ~np.eye(count, dtype=bool)
    # Cosines that do not differ tell nothing; the first stays, which says whether they are random.
    varied = [i for i, each in enumerate(cosines) if i == 0 or each[off].std() > 1e-5]
    return cosines[varied], tuple(shown)


def _blurred(images: Floats, blur: float) -> Floats:
    """Images (K, rows, cols), blurred as products of matrices, which are quicker than filters."""
    down, right = (gaussian_filter1d(np.eye(n, dtype=np.float32), blur) for n in images.shape[1:])
    return np.asarray(down @ images @ right.T)


def gram_matrix(images: Floats) -> Floats:
    """Sums of products of frames over all pixels, (K, K)."""
    flat = images.reshape(-1, images.shape[-1])
    return np.asarray(flat.T @ flat)


def cosines_of(gram: Floats) -> tuple[Floats, Floats]:
    """Cosines between frames, as they are and with the brightness of each frame taken out."""
    centred = gram - gram.mean(axis=0) - gram.mean(axis=1)[:, None] + gram.mean()
    return _scaled(gram), _scaled(centred)


def _scaled(gram: Floats) -> Floats:
    length = np.sqrt(np.maximum(np.diag(gram), 1e-12))
    # A frame that shows nothing has no cosine.
    return np.asarray(np.where(np.outer(length, length) > 1e-9, gram / np.outer(length, length), 0))


def normalised(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Vectors along the last axis, of mean 0 and length 1."""
    centred = values - values.mean(axis=-1, keepdims=True, dtype=np.float64)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return np.asarray(centred / np.maximum(length, 1e-9))
