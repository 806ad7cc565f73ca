"""What frames held out say of a row's error, against the error itself."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.coherent.row_errors import (
    held_out_frames,
    smooth_misfit,
    squared_misfit,
    without,
)
from lightmatrix.patterns.bits import BernoulliPatterns


@pytest.mark.parametrize("count", [8, 9, 16, 31, 64, 256])
def test_some_frames_all_over_are_held_out(count: int) -> None:
    held = held_out_frames(count)
    assert len(held) == len(set(held)) == max(2, count // 8)
    assert held.min() >= 0
    assert held.max() < count


def test_of_few_frames_none_is() -> None:
    assert not len(held_out_frames(7))


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
