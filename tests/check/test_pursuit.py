"""Predictions from a few projector pixels, and how these are chosen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check.pursuit import best_pixels, column_scale, predict_by_pursuit
from lightmatrix.patterns import pattern_set

SHAPE, COUNT, ROWS = (48, 64), 64, 40


def _values(patterns: lm.PatternSet) -> NDArray[np.float32]:
    """Samples of camera pixels that see three projector pixels each, not far from each other."""
    random = np.random.default_rng(0)
    place = random.integers(8, (SHAPE[0] - 8, SHAPE[1] - 8), (ROWS, 2))
    near = place[:, None] + random.integers(-3, 4, (ROWS, 3, 2))
    seen = patterns.columns(np.ravel_multi_index(near.reshape(-1, 2).T, SHAPE))
    light = np.einsum("kmp,p->mk", seen.reshape(COUNT, ROWS, 3), [0.5, 0.3, 0.2])
    return (light + 0.01 * random.standard_normal(light.shape)).astype(np.float32)


def _predicted(patterns: lm.PatternSet, values: Any, count: int = 60) -> NDArray[np.float32]:
    fold = np.where(np.arange(COUNT) < count, np.arange(COUNT) % 3, -1)
    seen = np.where(fold < 0, np.nan, values)
    return predict_by_pursuit(patterns, column_scale(patterns), seen, fold)


@pytest.fixture(params=["bits", "grey"])
def patterns(request: pytest.FixtureRequest) -> lm.PatternSet:
    if request.param == "bits":
        return lm.make_patterns("bernoulli", SHAPE, COUNT)
    return lm.ImagePatterns(np.random.default_rng(3).random((COUNT, *SHAPE), np.float32))


def test_what_a_part_holds_does_not_predict_it(patterns: lm.PatternSet) -> None:
    values = _values(patterns)
    before = _predicted(patterns, values)
    # Three pixels explain most of a row.
    assert ((before - values)[:, :60] ** 2).mean() < 0.3 * values.var(axis=1).mean()
    values[:, 0:60:3] = np.random.default_rng(1).random((ROWS, 20))
    after = _predicted(patterns, values)
    np.testing.assert_allclose(before[:, 0:60:3], after[:, 0:60:3], atol=1e-4)
    assert np.isfinite(after).all()
    assert np.abs(before[:, 1:60:3] - after[:, 1:60:3]).max() > 0.1


def test_the_best_pixel_correlates_most(
    patterns: lm.PatternSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Some pixels at a time.
    monkeypatch.setattr(pattern_set, "_PIXELS_AT_ONCE", patterns.pixels // 3)
    residual = np.random.default_rng(1).standard_normal((7, COUNT)).astype(np.float32)
    residual -= residual.mean(axis=1, keepdims=True)
    columns = patterns.columns(np.arange(patterns.pixels)).astype(np.float64)
    scores = residual @ columns / columns.std(axis=0)
    scale = column_scale(patterns)
    best = best_pixels(patterns, scale, residual)
    np.testing.assert_array_equal(best, scores.argmax(axis=1))
