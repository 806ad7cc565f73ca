"""Blur, leaking black, vignetting and room light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import lightmatrix as lm
from lightmatrix.errors import InputError
from lightmatrix.simulation import realism
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import Truth


@pytest.fixture
def truth() -> Truth:
    return ProceduralScene((9, 11), (12, 10), seed=2).truth()


def test_defocus_is_a_blur_of_the_pattern(truth: Truth) -> None:
    from scipy.ndimage import gaussian_filter

    image = np.zeros((12, 10))
    image[4:8, 3:6] = 1
    blurred = gaussian_filter(image, 0.8, mode="reflect", truncate=5)
    got = realism.defocus(truth, 0.8).matrix @ image.ravel()
    np.testing.assert_allclose(got, truth.matrix @ blurred.ravel(), rtol=0.03, atol=0.004)


def test_defocus_keeps_light_and_parts(truth: Truth) -> None:
    blurred = realism.defocus(truth, 1.3)
    # What reaches a spot on the projector; beyond its border there is no pixel to blur into it.
    field = gaussian_filter(np.ones(truth.projector_shape), 1.3, mode="constant", truncate=3)
    for part, before, rtol in (
        (blurred.matrix, truth.matrix, 1e-4),
        # The weakest entries are dropped, their light is counted as global.
        (blurred.direct, truth.direct, 5e-4),
    ):
        np.testing.assert_allclose(part.sum(axis=1), before @ field.ravel(), rtol=rtol, atol=1e-6)
    assert (blurred.direct_data <= blurred.matrix.data * (1 + 1e-5)).all()
    assert blurred.matrix.nnz > truth.matrix.nnz
    assert blurred.matrix.data.dtype == np.float32


@pytest.mark.parametrize("channels", [1, 3])
def test_a_blurred_camera_blurs_its_images(truth: Truth, channels: int) -> None:
    primary = "red" if channels == 3 else None
    patterns = lm.BernoulliPatterns((12, 10), 3)
    quiet: dict[str, Any] = {"bits": None, "noise": 0, "exposure": 0.01, "primary": primary}
    blurred = lm.simulate(truth, patterns, camera_blur=0.8, **quiet)
    sharp = lm.simulate(truth, patterns, **quiet)
    sigma = (0.8, 0.8, 0)[: 2 + (channels > 1)]
    for k in range(3):
        image = sharp.frames.read(k).astype(float)
        expected = gaussian_filter(image, sigma, mode="nearest", truncate=3)
        np.testing.assert_allclose(blurred.frames.read(k), expected, atol=2e-3 * image.max())
    assert (blurred.truth.direct_data <= blurred.truth.matrix.data * (1 + 1e-5)).all()
    assert 0 < blurred.truth.direct_data.sum() < blurred.truth.matrix.data.sum()


def test_a_full_well_is_shot_noise(truth: Truth) -> None:
    patterns = lm.BernoulliPatterns((12, 10), 3)
    assert lm.simulate(truth, patterns, full_well=10_000).sensor.shot_noise == 0.01
    assert lm.simulate(truth, patterns).sensor.shot_noise == 0


def test_vignetting_darkens_corners_only(truth: Truth) -> None:
    dark = realism.vignetting(truth, 0.4)
    gain = (dark.matrix.sum(axis=1) / truth.matrix.sum(axis=1)).reshape(9, 11)
    assert gain[4, 5] == pytest.approx(1)
    np.testing.assert_allclose(gain[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6, rtol=1e-5)
    np.testing.assert_allclose(
        dark.direct_data / dark.matrix.data, truth.direct_data / truth.matrix.data, rtol=1e-5
    )


def test_leak_lifts_black_and_leaves_white(truth: Truth) -> None:
    levels = np.array([0.0, 0.5, 1.0])
    patterns = lm.ImagePatterns(np.broadcast_to(levels[:, None, None], (3, 12, 10)))
    capture = lm.simulate(truth, patterns, exposure=0.1, bits=None, noise=0, leak=0.01)
    white = 0.1 * truth.matrix.sum(axis=1).reshape(truth.camera_shape)
    for number, level in enumerate([0.01, 0.505, 1.0]):
        np.testing.assert_allclose(capture.frame(number), level * white, rtol=1e-5)


def test_ambient_light_has_the_stated_mean(truth: Truth) -> None:
    room = realism.ambient(truth, 0.05)
    assert room.shape == (99,)
    assert (room > 0).all()
    assert room.mean() == pytest.approx(0.05 * truth.matrix.sum() / 99, rel=0.05)


@pytest.mark.parametrize("value", [-0.1, float("nan")])
@pytest.mark.parametrize("name", ["blur", "camera_blur", "vignetting", "leak", "ambient"])
def test_impossible_strengths_are_refused(truth: Truth, name: str, value: float) -> None:
    strength: dict[str, Any] = {name: value}
    with pytest.raises(InputError):
        lm.simulate(truth, lm.BernoulliPatterns((12, 10), 2), **strength)
