"""Predictions leave out the frame that they predict, as refitting without it does."""

from __future__ import annotations

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.check.prediction import best_pixels, column_scale, predict
from lightmatrix.patterns import pattern_set
from lightmatrix.patterns.bits import BernoulliPatterns

K, SHAPE = 80, (12, 14)


PATTERNS = BernoulliPatterns(SHAPE, K)


def samples(
    places: list[tuple[int, int]],
    noise: float = 0.0,
    top: float = np.inf,
    patterns: lm.PatternSet = PATTERNS,
) -> lm.Samples:
    """Camera pixels that see one projector pixel, and one as bright as a half 5 columns on."""
    columns = patterns.columns(np.arange(patterns.pixels))
    first = [np.ravel_multi_index(place, SHAPE) for place in places]
    light = columns[:, first].T + 0.5 * columns[:, [p + 5 for p in first]].T
    light = light + noise * np.random.default_rng(0).standard_normal(light.shape)
    return lm.Samples(np.minimum(light, top), light >= top, np.full(patterns.count, top))


def test_the_two_strongest_places_are_found() -> None:
    first, second = predict(PATTERNS, samples([(3, 4), (8, 2)])).places
    assert first.tolist() == [3 * 14 + 4, 8 * 14 + 2]
    assert second.tolist() == [3 * 14 + 9, 8 * 14 + 7]


@pytest.mark.parametrize("grey", [False, True])
def test_the_best_pixel_correlates_most(grey: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    patterns: lm.PatternSet = PATTERNS
    if grey:
        images = np.random.default_rng(3).random((K + 1, *SHAPE), np.float32)
        # Pixels differ in contrast, which counts nothing.
        patterns = lm.ImagePatterns(images[1:] * images[0])
    # Some pixels at a time.
    monkeypatch.setattr(pattern_set, "_PIXELS_AT_ONCE", patterns.pixels // 3)
    residual = np.random.default_rng(1).standard_normal((7, K)).astype(np.float32)
    residual -= residual.mean(axis=1, keepdims=True)
    columns = patterns.columns(np.arange(patterns.pixels)).astype(np.float64)
    scores = residual @ (columns / columns.std(axis=0))
    best = best_pixels(patterns, column_scale(patterns), residual)
    np.testing.assert_array_equal(best, scores.argmax(axis=1))


def test_clipped_and_doubted_samples_find_nothing() -> None:
    seen = samples([(3, 4)])
    spoilt = seen.values.copy()
    spoilt[0, :6] = np.random.default_rng(1).random(6) * 9
    clipped = np.arange(K) < 6
    hidden = predict(PATTERNS, lm.Samples(spoilt, clipped[None], np.full(K, np.inf)))
    assert hidden.places[0].tolist() == [3 * 14 + 4]
    plain = lm.Samples(spoilt, np.zeros((1, K), bool), np.full(K, np.inf))
    doubtful = predict(PATTERNS, plain, doubted=clipped)
    assert doubtful.places[0].tolist() == [3 * 14 + 4]
    # Predicted are they all the same.
    np.testing.assert_allclose(doubtful.expected[0, :6], seen.values[0, :6], atol=0.1)


@pytest.mark.parametrize("count", [K, 40])
def test_each_sample_is_predicted_without_itself(count: int) -> None:
    """The closed form is what ridge regression of the other frames gives.

    A row has about 50 columns: more and fewer than frames.
    """
    patterns = BernoulliPatterns(SHAPE, count, seed=1)
    seen = samples([(3, 4), (1, 1)], noise=0.05, patterns=patterns)
    made = predict(patterns, seen)
    for row in range(2):
        windows = []
        for place, scale in zip(made.places, (1.0, 0.5), strict=True):
            r, c = divmod(int(place[row]), SHAPE[1])
            for down in range(-2, 3):
                for right in range(-2, 3):
                    if 0 <= r + down < SHAPE[0] and 0 <= c + right < SHAPE[1]:
                        pixel = (r + down) * SHAPE[1] + c + right
                        fall = np.exp(-(down**2 + right**2) / 4)
                        windows.append(scale * fall * patterns.columns(np.array([pixel]))[:, 0])
        r, c = divmod(int(made.places[0][row]), SHAPE[1])
        around = np.zeros(count)
        for down in range(-6, 7, 2):
            for right in range(-6, 7, 2):
                if 0 <= r + down < SHAPE[0] and 0 <= c + right < SHAPE[1]:
                    pixel = (r + down) * SHAPE[1] + c + right
                    fall = np.exp(-(down**2 + right**2) / 18)
                    around += fall * patterns.columns(np.array([pixel]))[:, 0]
        windows.append(0.3 * (around - around.mean()) / around.std())
        means = patterns.means
        windows.append(0.1 * (means - means.mean()) / means.std())
        explain = np.stack(windows, axis=1).astype(float)
        target = seen.values[row]
        by_ridge = []
        for ridge in (0.003, 0.03, 0.3):
            left_out = np.empty(count)
            for k in range(count):
                rest = np.delete(np.arange(count), k)
                x, y = explain[rest], target[rest]
                centred = x - x.mean(axis=0)
                slope = np.linalg.solve(
                    centred.T @ centred + ridge * np.eye(x.shape[1]), centred.T @ (y - y.mean())
                )
                left_out[k] = y.mean() + (explain[k] - x.mean(axis=0)) @ slope
            by_ridge.append(left_out)
        missed = [float(((each - target) ** 2).mean()) for each in by_ridge]
        best = int(np.argmin(missed))
        np.testing.assert_allclose(made.expected[row], by_ridge[best], atol=2e-3)
        assert made.miss[row] == pytest.approx(missed[best] / target.var(), rel=0.02)


def test_samples_near_the_clip_level_are_not_trusted() -> None:
    seen = samples([(3, 4)], noise=0.02, top=1.2)
    made = predict(PATTERNS, seen)
    assert not made.trusted[seen.clipped].any()
    usual = np.sqrt(made.miss * seen.values.var(axis=1))[:, None]
    np.testing.assert_array_equal(made.trusted, ~seen.clipped & (made.expected < 1.2 - 3 * usual))
