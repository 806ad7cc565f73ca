"""What frames held out and residuals say of a row's error, and which frames are held out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.coherent.row_errors import (
    HeldOut,
    Predicted,
    bend,
    constant_light,
    held_out_frames,
    only_bounded,
    smooth_misfit,
    squared_misfit,
    without,
)
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns


@pytest.mark.parametrize("count", [8, 9, 16, 31, 64, 256])
def test_some_frames_all_over_are_held_out(count: int) -> None:
    held = held_out_frames(count)
    assert len(held) == len(set(held)) == (count // 8 if count >= 16 else 4)
    assert held.min() >= 0
    assert held.max() < count


def test_the_misfit_measures_the_error_of_the_row() -> None:
    patterns = BernoulliPatterns((32, 32), 400, seed=3)
    random = np.random.default_rng(0)
    error = 0.01 * random.standard_normal((5, 1024))
    values = np.zeros((5, 400), np.float32)
    held = np.arange(0, 400, 2)
    predicted = patterns.forward(error)[:, held].astype(np.float32)
    samples = Samples(values, np.zeros(values.shape, bool), np.ones(400, np.float32))
    misfit = squared_misfit(samples, predicted, held)
    np.testing.assert_allclose(np.sqrt(misfit) / 0.5, np.linalg.norm(error, axis=1), rtol=0.15)


def test_clipped_samples_count_only_below_their_bound() -> None:
    values = np.ones((1, 8), np.float32)
    samples = Samples(values, np.ones((1, 8), bool), np.ones(8, np.float32))
    held = np.arange(8)
    assert np.isnan(squared_misfit(samples, np.full((1, 8), 5, np.float32), held)[0])
    below = np.array([[0.5, 0.9, 5, 5, 5, 5, 5, 5]], np.float32)
    assert squared_misfit(samples, below, held)[0] == pytest.approx(0.08)


def test_clipped_samples_beyond_their_bound_do_not_hide_what_others_show() -> None:
    random = np.random.default_rng(1)
    values, predicted = random.random((2, 3, 8), dtype=np.float32)
    clipped = np.zeros((3, 8), bool)
    clipped[:, 3:] = True
    predicted[:, 3:] = 5
    held = np.arange(8)
    misfit = squared_misfit(Samples(values, clipped, np.ones(8, np.float32)), predicted, held)
    few = Samples(values[:, :3], clipped[:, :3], np.ones(3, np.float32))
    np.testing.assert_allclose(misfit, squared_misfit(few, predicted[:, :3], held[:3]))


def test_masked_frames_say_nothing() -> None:
    values = np.random.default_rng(0).random((2, 8)).astype(np.float32)
    weights = np.ones((2, 8), np.float32)
    weights[1] = 0
    samples = Samples(values, np.zeros((2, 8), bool), np.ones(8, np.float32), weights)
    held = np.array([1, 5])
    masked = without(samples, held)
    assert masked.weights is not None
    assert not masked.weights[:, held].any()
    assert masked.weights[0].sum() == 6
    misfit = squared_misfit(samples, np.zeros((2, 2), np.float32), held)
    assert np.isfinite(misfit[0])
    assert np.isnan(misfit[1])
    assert np.isfinite(smooth_misfit(misfit, (1, 2, 1), 0)).all()
    assert np.isnan(smooth_misfit(np.full(4, np.nan, np.float32), (2, 2, 1), 0)).all()


@pytest.mark.parametrize("spacing", [2, 4])
def test_every_pixel_gets_the_mean_of_the_known_ones_around(spacing: int) -> None:
    """A misfit that rises along both axes is interpolated linearly, at any spacing."""
    known = np.add.outer(np.arange(12.0), 3 * np.arange(15.0))
    image = np.full((11 * spacing + 1, 14 * spacing + 1), np.nan, np.float32)
    image[::spacing, ::spacing] = known
    smooth = smooth_misfit(image.ravel(), (*image.shape, 1), 0, spacing).reshape(image.shape)
    np.testing.assert_allclose(smooth[::spacing, ::spacing], known, atol=1e-5)
    half = spacing // 2
    between = (known[:-1, :-1] + known[1:, 1:]) / 2
    np.testing.assert_allclose(smooth[half::spacing, half::spacing], between, rtol=1e-5)


# ---- residuals

COUNT, ROWS = 64, 50
PATTERNS = lm.BernoulliPatterns((8, 8), COUNT, seed=3)
SHOWN = PATTERNS.rows(0, COUNT).astype(np.float64)
DIRECT = np.random.default_rng(0).uniform(0.2, 0.5, (ROWS, 1)) * SHOWN[:, :ROWS].T


def samples(values: NDArray[np.float64]) -> lm.Samples:
    values = np.asarray(values, np.float32)
    return lm.Samples(np.minimum(values, 1), values >= 1, np.ones(COUNT, np.float32))


def predicted(background: NDArray[np.float64]) -> Predicted:
    return Predicted(
        DIRECT.astype(np.float32),
        np.broadcast_to(background, DIRECT.shape).astype(np.float32),
        SHOWN.mean(axis=1),
    )


def test_light_that_does_not_follow_the_patterns_is_constant() -> None:
    # The prediction takes a constant 0.1 for a background, which follows the mean of the patterns.
    mean = SHOWN.mean(axis=1)
    taken = predicted(0.1 * mean / mean.mean())
    seen = samples(DIRECT + 0.1)
    share = constant_light(seen, taken)
    np.testing.assert_allclose(share, 0.1 / seen.values.mean(axis=1), rtol=1e-3)
    right = samples(DIRECT + 0.1 * mean / mean.mean())
    assert np.abs(constant_light(right, taken)).max() < 1e-5
    # What was not taken for a background cannot be wrong.
    assert not constant_light(seen, predicted(0 * mean)).any()


@pytest.mark.parametrize("gamma", [1.0, 1.5, 2.2])
def test_residuals_bend_under_a_curve(gamma: float) -> None:
    generator = np.random.default_rng(1)
    light = generator.uniform(0.05, 0.9, (ROWS, COUNT))
    curved = light ** (1 / gamma)
    # The best line through the curve.
    lines = np.stack(
        [np.polyval(np.polyfit(x, y, 1), x) for x, y in zip(light, curved, strict=True)]
    )
    found = bend(samples(curved), Predicted(lines.astype(np.float32), 0 * lines, np.ones(COUNT)))
    if gamma == 1:
        assert np.abs(found).max() < 1e-4
    else:
        assert found.max() < -0.05


def test_rows_are_bounded_if_their_strongest_pixel_always_clips() -> None:
    pixels = csr_array(np.eye(3, 64) + 0.1)
    light = SHOWN[:, :3].T * np.array([[2.0], [0.9], [2.0]])
    seen = samples(light)
    # The strongest pixel of the last row is seen once.
    first = int(np.flatnonzero(SHOWN[:, 2])[0])
    seen.values[2, first], seen.clipped[2, first] = 0.95, False
    np.testing.assert_array_equal(only_bounded(seen, pixels, PATTERNS), [True, False, False])
    assert not only_bounded(seen, csr_array((3, 64)), PATTERNS).any()


# ---- which frames are held out

BASE = lm.BernoulliPatterns((16, 16), 16, seed=1).rows(0, 16).reshape(16, 16, 16)


def images(stack: NDArray[np.float32]) -> lm.ImagePatterns:
    return lm.ImagePatterns(np.asarray(stack, np.float32))


@pytest.mark.parametrize("times", [2, 4, 8])
@pytest.mark.parametrize("interleaved", [True, False])
def test_a_pattern_is_held_out_each_time_it_is_shown(times: int, interleaved: bool) -> None:
    shown = np.arange(16 * times) // times if interleaved else np.arange(16 * times) % 16
    held = HeldOut.choose(images(BASE[shown]))
    assert len(held.judged) >= 2
    assert len(held.frames) == times * len(held.judged)
    others = np.delete(shown, held.frames)
    assert not np.isin(shown[held.judged], others).any()


def test_an_inverse_is_held_out_with_its_pattern() -> None:
    held = HeldOut.choose(images(np.stack([BASE, 1 - BASE], 1).reshape(-1, 16, 16)))
    assert len(held.frames) == 2 * len(held.judged) == 4
    assert set(held.frames // 2) == set(held.judged // 2)


def test_nothing_is_held_out_where_that_tests_nothing() -> None:
    lines = np.broadcast_to(BASE[:, :1], BASE.shape)
    two = np.repeat(BASE[:2], 8, axis=0)
    for patterns in (images(lines), images(two), lm.BernoulliPatterns((16, 16), 7)):
        held = HeldOut.choose(patterns)
        assert not len(held.frames)
        assert not len(held.judged)


@pytest.mark.parametrize("patterns", ["shown twice", "shown four times", "with inverses"])
def test_frames_that_repeat_others_do_not_lower_the_stated_error(patterns: str) -> None:
    case = draw("speckle", patterns, "intact", 16, 0)
    estimate = lm.estimate(case.capture, check=False)
    stated = OwnError(estimate).estimated
    assert stated is not None
    assert stated > 0.5 * relative_error(estimate, case.truth) > 0.1
