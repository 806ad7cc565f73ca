"""Whether the frames follow the patterns, told from the samples alone.

Where a camera pixel sees a few projector pixels, its samples follow those pixels of the patterns.
So each of some bright pixels is explained, from part of the frames, by the few projector pixels
that correlate best (orthogonal matching pursuit, Pati et al. 1993), and what it should show in the
other frames is predicted (cross-validation). An observed frame that its own prediction misses and
that of another frame meets is out of place. Diffuse scenes and very few patterns predict nothing,
and then nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet

# An observed frame is out of place if another prediction misses it by less than this share of
# what its own prediction does, and of what no prediction at all (the row's mean) does.
_DECISIVE = 0.45
_INFORMATIVE = 0.6
_PROJECTOR_PIXELS = 3
_FEWEST_FRAMES = 12
_MOST_ROWS = 300
# Multiplications spent on correlations; about a second.
_WORK = 2e10
_CORRELATION_BYTES = 64 << 20


def check_order(
    patterns: PatternSet,
    tiles: Iterable[tuple[int, Samples]],
    rows: int,
    name: Callable[[int], str] = "frame {}".format,
) -> None:
    """Refuse frames that are swapped, shifted or reversed against the patterns.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    tiles : iterable of (int, Samples)
        Samples (m, K) of all camera rows, tile by tile.
    rows : int
        Number of camera rows M.
    name : callable
        What to call the frame of an index.

    Raises
    ------
    InputError
        Naming the frames.
    """
    if patterns.count < _FEWEST_FRAMES:
        return
    samples = _bright_rows(patterns, tiles, rows)
    if samples is None:
        return
    values, ceiling = samples
    count = patterns.count
    frames = np.arange(count)
    miss, blind = prediction_misses(patterns, values, ceiling, frames)
    miss[_alike(patterns)] = np.inf
    best = float(np.median(np.diag(miss)))
    if best > 0.5:
        # Most frames are missed, so perhaps they are all displaced alike.
        for order, words in (
            (np.append(frames[1:], -1), "each image shows the pattern after its own"),
            (np.append(-1, frames[:-1]), "each image shows the pattern before its own"),
            (frames[::-1], "the images follow the patterns backwards"),
        ):
            other, _ = prediction_misses(patterns, values, ceiling, order)
            reached = float(np.median(np.diag(other)[order >= 0]))
            if reached < min(_DECISIVE * best, _INFORMATIVE):
                raise _out_of_order(f"the images do not follow the patterns: {words}")
    complaint = _describe(_displaced(miss, blind), miss, name)
    if complaint is not None:
        raise _out_of_order(complaint)


def prediction_misses(
    patterns: PatternSet,
    values: NDArray[np.float32],
    ceiling: NDArray[np.float32],
    order: NDArray[np.integer],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far each observed frame is from the prediction for each frame.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    values : (m, K) float32
        Observed samples.
    ceiling : (m, 1) float32
        Level above which neither samples nor predictions count.
    order : (K,) int
        The pattern assumed to be shown in each frame; -1 for none.

    Returns
    -------
    misses : (K, K) float64
        Mean square difference of observed frame (row) and predicted frame (column), in units of
        the variance of the pixel's samples. The prediction of a frame never used that frame.
    blind : (K,) float64
        The same for no prediction at all, the mean of the row.
    """
    known = np.flatnonzero(order >= 0)
    # What all rows do together is the brightness of the frame (flicker, the mean of the pattern):
    # no evidence of which pixels were lit, and a prediction of it would err in all rows alike.
    common = values.mean(axis=0, keepdims=True)
    predicted = np.tile((values - common).mean(axis=1, keepdims=True), (1, len(order)))
    scale = _column_scale(patterns)
    folds = 4 if len(order) < 128 else 2
    fold = np.random.default_rng(0).permutation(len(known)) % folds
    for part in range(folds):
        train, held = known[fold != part], known[fold == part]
        predicted[:, held] = _predict(patterns, scale, values - common, order, train, held)
    predicted = np.minimum(predicted + common, ceiling)
    observed, expected = _variation(values, values), _variation(predicted, values)
    squares = (observed**2).sum(axis=0)[:, None] + (expected**2).sum(axis=0)[None, :]
    miss = (squares - 2 * observed.T @ expected) / len(values)
    return np.maximum(miss, 1e-12), (observed**2).mean(axis=0)


def _variation(values: NDArray[np.float32], scale: NDArray[np.float32]) -> NDArray[np.float64]:
    """Deviations from each row's and each frame's mean, over the row's spread in `scale`."""
    spread = scale.std(axis=1, keepdims=True).astype(np.float64)
    relative = (values - scale.mean(axis=1, keepdims=True)) / np.maximum(spread, 1e-12)
    return np.asarray(relative - relative.mean(axis=0, keepdims=True))


def _predict(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    values: NDArray[np.float32],
    order: NDArray[np.integer],
    train: NDArray[np.integer],
    held: NDArray[np.integer],
) -> NDArray[np.float32]:
    """What each row should show in the held-out frames, from the frames in `train`."""
    mean = values[:, train].mean(axis=1, keepdims=True)
    centred = values[:, train] - mean
    residual = centred
    chosen = np.empty((len(values), 0), np.int64)
    for _ in range(_PROJECTOR_PIXELS):
        best = _best_pixels(patterns, scale, residual, order[train])
        chosen = np.column_stack([chosen, best])
        columns = patterns.columns(chosen.ravel()).reshape(patterns.count, *chosen.shape)
        shown = columns[order[train]]
        level = shown.mean(axis=0)
        basis = np.moveaxis(shown - level, 0, 1)
        gram = basis.transpose(0, 2, 1) @ basis
        # Pixels chosen twice, or alike, share their light.
        ridge = 1e-4 * np.trace(gram, axis1=1, axis2=2) + 1e-6
        gram += ridge[:, None, None] * np.eye(chosen.shape[1], dtype=gram.dtype)
        light = np.linalg.solve(gram, basis.transpose(0, 2, 1) @ centred[..., None])
        residual = centred - (basis @ light)[..., 0]
    expected = np.moveaxis(columns[order[held]] - level, 0, 1)
    return np.asarray(mean + (expected @ light)[..., 0], np.float32)


def _best_pixels(
    patterns: PatternSet,
    scale: NDArray[np.float32],
    residual: NDArray[np.float32],
    shown: NDArray[np.integer],
) -> NDArray[np.int64]:
    """The projector pixel that correlates best with each row of residuals, (m,)."""
    spread = np.zeros((len(residual), patterns.count), np.float32)
    spread[:, shown] = residual
    group = max(1, _CORRELATION_BYTES // (4 * patterns.pixels))
    # Pixels that no frame tells apart are chosen between by lot, row by row: were it always the
    # first, all rows would agree on a prediction that nothing supports.
    lots = 1 + 1e-3 * np.random.default_rng(0).random(2 * patterns.pixels, np.float32)
    best = np.empty(len(spread), np.int64)
    for start in range(0, len(spread), group):
        for row, scores in enumerate(patterns.adjoint(spread[start : start + group]), start):
            first = row * 7919 % patterns.pixels
            best[row] = (scores * scale * lots[first : first + patterns.pixels]).argmax()
    return best


def _column_scale(patterns: PatternSet) -> NDArray[np.float32]:
    """One over the standard deviation of each projector pixel over the patterns; 0 if constant."""
    total = np.zeros(patterns.pixels)
    squares = np.zeros(patterns.pixels)
    for _, block in patterns.chunks():
        total += block.sum(axis=0, dtype=np.float64)
        squares += np.einsum("kn,kn->n", block, block)
    variance = squares / patterns.count - (total / patterns.count) ** 2
    steady = variance < 1e-6
    return np.where(steady, 0, 1 / np.sqrt(np.where(steady, 1, variance))).astype(np.float32)


def _bright_rows(
    patterns: PatternSet, tiles: Iterable[tuple[int, Samples]], rows: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Some of the rows that vary most, cut off at their lowest clip level; None if none varies."""
    folds = 4 if patterns.count < 128 else 2
    cost = patterns.count * patterns.pixels * folds * _PROJECTOR_PIXELS
    wanted = int(np.clip(_WORK / cost, 24, _MOST_ROWS))
    generator = np.random.default_rng(0)
    found, levels = [], []
    for _, tile in tiles:
        level = np.broadcast_to(tile.clip_level, tile.values.shape).min(axis=1, keepdims=True)
        values = np.minimum(tile.values, level)
        spread = values.std(axis=1)
        share = -(-wanted * len(values) // rows)
        # A random choice among the better third: the very best are often all in one place.
        better = np.argsort(-spread)[: max(share, len(values) // 3)]
        pick = generator.permutation(better)[:share]
        pick = pick[spread[pick] > 0]
        found.append(values[pick])
        levels.append(level[pick])
    if sum(map(len, found)) < 16:
        return None
    return np.concatenate(found), np.concatenate(levels)


def _alike(patterns: PatternSet) -> NDArray[np.bool_]:
    """Which pairs of different frames show (nearly) the same pattern and may change places."""
    sample = np.random.default_rng(0).permutation(patterns.pixels)[:4096]
    shown = patterns.columns(sample).astype(np.float64)
    power = (shown**2).sum(axis=1)
    distance = power[:, None] + power[None, :] - 2 * shown @ shown.T
    alike = distance < 0.02 * len(sample) * shown.var(axis=0).mean()
    return np.asarray(alike & ~np.eye(len(alike), dtype=bool))


def _displaced(miss: NDArray[np.float64], blind: NDArray[np.floating]) -> dict[int, int]:
    """Which observed frame shows the pattern of which other frame."""
    other = miss + np.diag(np.full(len(miss), np.inf))
    nearest = other.argmin(axis=1)
    least = other.min(axis=1)
    clear = (least < _DECISIVE * np.diag(miss)) & (least < _INFORMATIVE * blind)
    # White, black and very fine stripes are the same all over the camera and tell nothing.
    clear &= blind > 0.25 * np.median(blind)
    return {int(k): int(nearest[k]) for k in np.flatnonzero(clear)}


def _describe(
    displaced: dict[int, int], miss: NDArray[np.float64], name: Callable[[int], str]
) -> str | None:
    if not displaced:
        return None
    steps = [shown - frame for frame, shown in displaced.items()]
    for step, words in ((1, "after its own: is one missing"), (-1, "before its own: is one extra")):
        if len(steps) >= 3 and steps.count(step) > 0.8 * len(steps):
            first, last = name(min(displaced)), name(max(displaced))
            return f"from {first} to {last}, each image shows the pattern {words}?"
    # The partner of a clear case need not be as clear.
    swapped = sorted(
        {
            (min(k, s), max(k, s))
            for k, s in displaced.items()
            if displaced.get(s, k) == k and miss[s, k] < 0.75 * miss[s, s]
        }
    )
    if swapped:
        pairs = ", ".join(f"{name(k)} and {name(s)}" for k, s in swapped[:5])
        return f"{pairs} look swapped"
    # One image alone is displaced when it repeats another, or when its partner is unclear.
    frame, shown = next(iter(displaced.items()))
    return f"{name(frame)} shows the pattern of {name(shown)}: is it swapped, repeated or late?"


def _out_of_order(complaint: str) -> InputError:
    return InputError(
        complaint,
        hint="put the images in the order of the patterns; --no-check takes them as they are",
    )
