"""The default regularization."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.estimators.automatic_regularization import (
    TAIL_SHARE,
    column_length,
    default_regularization,
)
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns


def test_the_tail_decides_at_low_noise_and_the_noise_at_high() -> None:
    patterns = BernoulliPatterns((64, 64), 256)
    assert default_regularization(patterns, 2.0, noise=0.0) == pytest.approx(2 * TAIL_SHARE)
    noisy = default_regularization(patterns, 1.0, noise=0.02)
    assert noisy > TAIL_SHARE
    assert default_regularization(patterns, 1.0, noise=0.04) == pytest.approx(2 * noisy)
    # With twice the patterns the threshold is sqrt(2) times as large.
    more = default_regularization(BernoulliPatterns((64, 64), 512), 1.0, noise=0.02)
    assert more == pytest.approx(noisy * np.sqrt(2), rel=0.01)


def test_scales_with_the_units_of_the_samples() -> None:
    patterns = BernoulliPatterns((32, 32), 512)
    one = default_regularization(patterns, 1.0, noise=0.01)
    assert default_regularization(patterns, 255.0, noise=2.55) == pytest.approx(255 * one)


def test_column_length_is_that_of_the_centred_columns() -> None:
    stack = np.random.default_rng(0).random((20, 6, 7)).astype(np.float32)
    p = stack.reshape(20, -1).astype(np.float64)
    centred = p - p.mean(axis=1, keepdims=True)
    expected = np.sqrt((centred**2).sum(axis=0).mean())
    assert column_length(ImagePatterns(stack)) == pytest.approx(expected)
    assert column_length(ImagePatterns(np.ones((3, 2, 2), np.float32))) == pytest.approx(
        0, abs=1e-7
    )
