"""Expected samples: what neighbours' rows give in a row's place, by the definition."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.coherent.neighbourhood import REACH, Neighbourhood, unseen_patterns
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.sparse_rows import SparseRows

LEVEL = 0.5


def neighbourhood(camera: Any, shown: PatternSet, seed: int, filled: float = 0.2) -> Neighbourhood:
    random = np.random.default_rng(seed)
    rows = np.prod(camera)
    dense = random.random((rows, shown.pixels)).astype(np.float32)
    dense[random.random(dense.shape) > filled] = 0
    return Neighbourhood(without_background(csr_array(dense)), camera, single(shown))


def single(patterns: PatternSet) -> AtomPatterns:
    return AtomPatterns(patterns, (0.0,))


def without_background(rows: csr_array) -> SparseRows:
    return SparseRows(rows, np.zeros((rows.shape[0], 1), np.float32))


def backgrounds_of(rows: int, patterns: int, seed: int) -> Any:
    return 0.1 * np.random.default_rng(seed).random((rows, patterns)).astype(np.float32)


def samples_of(shown: PatternSet, rows: int, seed: int) -> Samples:
    random = np.random.default_rng(seed)
    values = (random.random((rows, shown.count)) * LEVEL * 2).astype(np.float32)
    clipped = values > LEVEL
    values[clipped] = LEVEL
    weights = random.choice([0, 0.2, 1], (rows, shown.count)).astype(np.float32)
    weights[random.random(rows) < 0.1] = 0
    return Samples(values, clipped, np.full(shown.count, LEVEL, np.float32), weights)


def by_definition(
    around: Neighbourhood,
    shown: PatternSet,
    unseen: PatternSet,
    samples: Samples,
    background: Any,
    row: int,
) -> tuple[Any, Any]:
    """Mean and variance of the guesses at the samples of one row, entry by entry."""
    camera_rows, camera_cols, channels = around.camera
    images = np.concatenate([shown.images(), unseen.images()]).astype(np.float64)
    assert samples.weights is not None
    y, clipped, weights = samples.values[row], samples.clipped[row], samples.weights[row]
    r, c, channel = (int(i) for i in np.unravel_index(row, around.camera))
    guesses, counts = [], []
    for other_r in range(max(0, r - REACH), min(camera_rows, r + REACH + 1)):
        for other_c in range(max(0, c - REACH), min(camera_cols, c + REACH + 1)):
            other = (other_r * camera_cols + other_c) * channels + channel
            step = np.array([other_r - r, other_c - c], np.float32)
            # Not as a product of matrices, which rounds otherwise.
            part = (around.jacobian[row].reshape(2, 2) * step).sum(axis=1)
            entries = around.rows.coefficients[[other]].toarray().reshape(shown.shape)
            places = np.argwhere(entries > 0)
            for moved, share in whole_numbers(part):
                kept = ((places >= moved) & (places < moved + shown.shape)).all(axis=1)
                if other == row or not kept.any():
                    continue
                guess = background[other].astype(np.float64)
                for place in places[kept]:
                    guess = guess + entries[tuple(place)] * images[:, *(place - moved)]
                known = weights * ~clipped
                u = guess[: shown.count]
                scale = (LEVEL**2 + known @ (y * u)) / (LEVEL**2 + known @ (u * u))
                scale = min(max(scale, 0.5), 2)
                off = y - scale * u
                off[clipped] = np.maximum(off[clipped], 0)
                misfit = (weights * off**2).mean() / LEVEL**2
                guesses.append(scale * guess)
                counts.append(share ** (4 * clipped.mean()) * (misfit + 1e-4) ** -2)
    if not guesses:
        return None, None
    mean = np.average(guesses, axis=0, weights=counts)
    spread = np.average((np.array(guesses) - mean) ** 2, axis=0, weights=counts)
    # What they err in common: how far the mean misses what is known, beyond 15 %.
    known = weights * ~clipped
    missed = known @ (y - mean[: shown.count]) ** 2 / max(known.sum(), 1e-30)
    return mean, spread + max(0, missed - (0.15 * max(LEVEL, mean.max())) ** 2)


def whole_numbers(moved: NDArray[np.float32]) -> list[tuple[NDArray[np.int64], float]]:
    """The one, two or four whole displacements that one of parts of pixels may be, with shares."""
    axes = []
    close, one = np.float32(0.1), np.float32(1)
    for part in moved:
        below = int(np.floor(part))
        # In float32, as it is done: whether a place counts at all must not hang on rounding.
        beyond = (part - np.float32(below) - close) / (one - 2 * close)
        beyond = min(max(float(beyond), 0), 1)
        axes.append([(n, s) for n, s in ((below, 1 - beyond), (below + 1, beyond)) if s > 0])
    return [(np.array([r, c]), a * b) for (r, a), (c, b) in product(*axes)]


def all_of(samples: Samples) -> NDArray[np.int64]:
    return np.arange(samples.count)


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.integers(1, 5), st.integers(1, 5), st.sampled_from([1, 3])),
    st.tuples(st.integers(2, 7), st.integers(2, 7)),
    st.integers(1, 70),
    st.integers(0, 2**16),
)
# A Jacobian at the very edge of what counts as whole.
@example((5, 5, 3), (2, 5), 1, 1)
def test_they_are_the_mean_of_the_guesses(camera: Any, projector: Any, k: int, seed: int) -> None:
    shown, unseen = BernoulliPatterns(projector, k, seed=seed), unseen_patterns(projector)
    around = neighbourhood(camera, shown, seed)
    samples = samples_of(shown, around.rows.count, seed)
    background = backgrounds_of(around.rows.count, k + unseen.count, seed)
    pseudo = around.pseudo_samples(
        single(unseen), samples, samples.clipped, LEVEL, all_of(samples), background
    )
    for row in range(around.rows.count):
        mean, variance = by_definition(around, shown, unseen, samples, background, row)
        if mean is None:
            assert not pseudo.weights[row].any()
            continue
        mean[:k] = np.where(samples.clipped[row], np.maximum(mean[:k], LEVEL), mean[:k])
        np.testing.assert_allclose(pseudo.values[row], mean, rtol=1e-3, atol=1e-5)
        deviation = 0.0033 * LEVEL * min(1, k / 12) ** 2
        weights = 1 / (1 + (variance + (0.02 * mean) ** 2) / deviation**2)
        weights[:k] *= samples.clipped[row]
        assert samples.weights is not None
        used = samples.weights[row] > 0
        weights *= used.any() * min(1, 32 / max(1, (used & ~samples.clipped[row]).sum())) ** 2
        weights[weights < 1e-4] = 0
        near = np.isclose(pseudo.weights[row], weights, rtol=0.02, atol=2e-4)
        assert near.all()


def test_rows_asked_for_apart_are_the_same() -> None:
    shown, unseen = BernoulliPatterns((9, 8), 20), unseen_patterns((9, 8))
    around = neighbourhood((7, 6, 1), shown, 3)
    samples = samples_of(shown, 42, 1)
    background = backgrounds_of(42, 20 + unseen.count, 2)
    whole = around.pseudo_samples(
        single(unseen), samples, samples.clipped, LEVEL, all_of(samples), background
    )
    for part in (np.arange(17, 30), np.array([17, 18, 23, 29])):
        some = samples.rows(part)
        first, last = around.around(17, 30)
        near = background[first:last].copy()
        pseudo = around.pseudo_samples(single(unseen), some, some.clipped, LEVEL, part, near)
        assert np.array_equal(pseudo.values, whole.values[part])
        assert np.array_equal(pseudo.weights, whole.weights[part])


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("finer", [1, 2])
def test_footprints_are_followed_however_the_projector_is_turned(turn: int, finer: int) -> None:
    side, projector = 12, (12 * finer, 12 * finer)
    place = np.rot90(np.arange(projector[0] * projector[1]).reshape(projector), turn)
    place = place[::finer, ::finer]
    rows = csr_array((np.ones(side**2, np.float32), place.ravel(), np.arange(side**2 + 1)))
    rows.resize((side**2, projector[0] * projector[1]))
    shown, unseen = BernoulliPatterns(projector, 30), unseen_patterns(projector)
    around = Neighbourhood(without_background(rows), (side, side, 1), single(shown))
    turned = {0: (1, 0, 0, 1), 1: (0, 1, -1, 0), 2: (-1, 0, 0, -1), 3: (0, -1, 1, 0)}[turn]
    jacobian = around.jacobian.reshape(side, side, 4)[3:-3, 3:-3]
    assert np.array_equal(jacobian, np.broadcast_to(finer * np.array(turned), jacobian.shape))
    # All neighbours agree: clipped samples are as good as known, but for what neighbours share.
    values = shown.forward(rows.toarray())
    clipped = np.zeros(values.shape, bool)
    clipped[:, ::2] = values[:, ::2] > 0
    seen = np.where(clipped, LEVEL, values)
    samples = Samples(seen, clipped, np.full(30, LEVEL, np.float32), None)
    dark = np.zeros((side**2, 30 + unseen.count), np.float32)
    pseudo = around.pseudo_samples(single(unseen), samples, clipped, LEVEL, all_of(samples), dark)
    inside = np.zeros((side, side), bool)
    inside[5:-5, 5:-5] = True
    middle = inside.ravel()
    np.testing.assert_allclose(
        pseudo.values[middle][:, 30:], unseen.forward(rows.toarray())[middle]
    )
    np.testing.assert_allclose(pseudo.values[middle][:, :30][clipped[middle]], 1)
    assert (pseudo.weights[middle][:, :30][clipped[middle]] > 0).all()


def test_neighbours_that_know_nothing_are_not_asked() -> None:
    shown, unseen = BernoulliPatterns((5, 5), 9), unseen_patterns((5, 5))
    around = neighbourhood((4, 4, 1), shown, 0)
    dark = replace(around, rows=without_background(csr_array((16, 25), dtype=np.float32)))
    samples = samples_of(shown, 16, 0)
    background = backgrounds_of(16, 9 + unseen.count, 0)
    pseudo = dark.pseudo_samples(
        single(unseen), samples, samples.clipped, LEVEL, all_of(samples), background
    )
    assert not pseudo.weights.any()
    assert np.isfinite(pseudo.values).all()
