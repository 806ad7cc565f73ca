"""What residuals show of constant light, of curves, and of light beyond the clip level."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.estimators.coherent.row_errors import (
    Predicted,
    bend,
    constant_light,
    only_bounded,
    squared_residual,
)

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


def test_patterns_of_one_brightness_show_it_by_halos() -> None:
    local = SHOWN[:, :8].mean(axis=1)
    taken = Predicted(
        DIRECT.astype(np.float32),
        np.broadcast_to(0.1 * local / local.mean(), DIRECT.shape).astype(np.float32),
        np.full(COUNT, 0.5),
    )
    seen = samples(DIRECT + 0.1)
    np.testing.assert_allclose(
        constant_light(seen, taken), 0.1 / seen.values.mean(axis=1), rtol=1e-3
    )


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


def test_the_residual_ignores_clipped_samples() -> None:
    seen = samples(np.where(np.arange(COUNT) < 32, 2.0, 0.3) * np.ones((2, 1)))
    taken = Predicted(
        np.full((2, COUNT), 0.1, np.float32), np.zeros((2, COUNT), np.float32), np.ones(COUNT)
    )
    np.testing.assert_allclose(squared_residual(seen, taken), 0.04, rtol=1e-5)
