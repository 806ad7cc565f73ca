"""What photographs and patterns are compared by, each part held against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import lightmatrix as lm
from lightmatrix.diagnosis import frame_cosines
from lightmatrix.diagnosis.frame_cosines import (
    binned_shape,
    cosines_of,
    gram_matrix,
    normalised,
    pattern_cosines,
    pattern_images,
    standardised_frames,
)
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.bits import BernoulliPatterns

K = 20


def survey(frames: NDArray[np.uint8]) -> Survey:
    patterns = BernoulliPatterns((4, 4), len(frames))
    capture = lm.Capture.from_arrays(patterns, frames, lm.Decoder(clip=255, full_scale=255))
    return Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)


def random_frames(*shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 250, (K, *shape)).astype(np.uint8)


def test_pixels_that_vary_have_mean_0_and_variance_1() -> None:
    frames = random_frames(8, 9, 3)
    # A fifth of the variation of the others, and three fifths.
    frames[:, 2] = 100 + frames[:, 2] // 5
    frames[:, 3] = 100 + 3 * (frames[:, 3] // 5)
    taken = survey(frames)
    taken.valid[9 * 3 : 9 * 3 + 3] = False
    result = standardised_frames(taken, 16)
    assert result is not None
    images, rows = result
    assert images.shape == (8, 9, 3, 16)
    np.testing.assert_array_equal(rows, np.arange(8))
    counted = np.ones((8, 9), bool)
    counted[2] = counted[1, 0] = False
    assert not images[~counted].any()
    np.testing.assert_allclose(images[counted].mean(axis=-1), 0, atol=1e-5)
    np.testing.assert_allclose(images[counted].std(axis=-1), 1, atol=1e-4)
    own = np.moveaxis(frames[:16].astype(float), 0, -1)
    own = (own - own.mean(axis=-1, keepdims=True)) / own.std(axis=-1, keepdims=True)
    np.testing.assert_allclose(images[counted], own[counted], atol=1e-3)


def test_40_pixels_must_vary() -> None:
    frames = np.full((K, 8, 8), 100, np.uint8)
    frames[:, :5] = random_frames(5, 8)
    assert standardised_frames(survey(frames), K) is not None
    frames[:, 0, 0] = 100
    assert standardised_frames(survey(frames), K) is None


def test_a_pixel_that_varies_later_is_0() -> None:
    frames = random_frames(8, 8)
    frames[:16, 4, 4] = 7
    frames[16:, 4, 4] = 250
    result = standardised_frames(survey(frames), 16)
    assert result is not None
    assert not result[0][4, 4].any()


@pytest.mark.parametrize("shape", [(40, 61), (41, 60)])
def test_thinned_frames_stay_the_same_when_they_are_turned(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_cosines, "_MOST_SAMPLES", shape[0] * shape[1] * K // 9)
    frames = random_frames(*shape)
    one, other = (standardised_frames(survey(f), K) for f in (frames, frames[:, ::-1, ::-1]))
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one[0], other[0][::-1, ::-1])
    # Every third row and column, or some more in the middle.
    assert shape[0] // 3 <= len(one[1]) <= shape[0] // 3 + 2
    np.testing.assert_array_equal(one[1], shape[0] - 1 - one[1][::-1])
    assert np.diff(one[1]).max() <= 4
    assert np.bincount(np.diff(one[1]))[3] >= len(one[1]) - 2


def test_large_projectors_are_binned() -> None:
    for shape, binned in (
        ((256, 256), (256, 256)),
        ((257, 256), (128, 128)),
        ((100, 656), (50, 328)),
        ((1, 200_000), (1, 50_000)),
        ((1080, 1920), (135, 240)),
    ):
        assert binned_shape(BernoulliPatterns(shape, 1)) == binned


def test_binned_patterns_are_means_of_blocks() -> None:
    images = np.random.default_rng(0).random((5, 11, 8), np.float32)
    binned = pattern_images(lm.ImagePatterns(images), 3, (5, 2))
    assert binned.shape == (3, 5, 2)
    for k, row, col in np.ndindex(3, 5, 2):
        block = images[k, 2 * row : 2 * row + 2, 4 * col : 4 * col + 4]
        assert binned[k, row, col] == pytest.approx(block.mean(), rel=1e-5)


def test_cosines_between_frames() -> None:
    images = np.random.default_rng(0).standard_normal((6, 7, 4)).astype(np.float32)
    images[..., 3] = 0
    gram = gram_matrix(images)
    flat = images.reshape(-1, 4)
    cosines, centred = cosines_of(gram)
    for j, k in np.ndindex(3, 3):
        one, other = flat[:, j], flat[:, k]
        expected = one @ other / np.sqrt((one @ one) * (other @ other))
        assert cosines[j, k] == pytest.approx(expected, abs=1e-5)
    assert not cosines[3].any()
    # Without what all frames have in common.
    rest = flat - flat.mean(axis=1, keepdims=True)
    own = rest.T @ rest
    length = np.sqrt(np.diag(own))
    np.testing.assert_allclose(centred, own / np.outer(length, length), atol=1e-5)


def test_vectors_of_mean_0_and_length_1() -> None:
    values = np.random.default_rng(0).random((3, 50)).astype(np.float32)
    result = normalised(values)
    np.testing.assert_allclose(result.mean(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose((result**2).sum(axis=1), 1)
    np.testing.assert_allclose(result[0] @ result[1], np.corrcoef(values[0], values[1])[0, 1])
    assert not normalised(np.full(9, 3.0)).any()


def test_patterns_are_compared_through_blurs_and_in_cells() -> None:
    patterns = np.random.default_rng(0).random((K, 32, 40), np.float32)
    features, shown = pattern_cosines(patterns)
    # The blurs of 0, 1, 2, 4 and 8 pixels, 4 + 16 cells without blur and 4 under one of 2 pixels,
    # and the brightness, whose centred cosines are 1 or -1; each twice.
    assert len(features) == 2 * (5 + 4 + 16 + 4 + 1)
    assert len(shown) == 5
    centred = (patterns - patterns.mean(axis=0)).reshape(K, -1)
    np.testing.assert_allclose(features[0], cosines_of(centred @ centred.T)[0], atol=1e-5)
    brightness = centred.mean(axis=1)
    expected = np.sign(np.outer(brightness, brightness))
    np.testing.assert_allclose(features[-2], expected, atol=1e-4)
    blurred = np.stack([gaussian_filter(pattern, 1.0) for pattern in patterns])
    blurred = (blurred - blurred.mean(axis=0)).reshape(K, -1)
    np.testing.assert_allclose(features[42], cosines_of(blurred @ blurred.T)[0], atol=1e-4)
    # A pattern whose upper left quarter is another's has a cosine of 1 with it there.
    patterns[3, :16, :20] = patterns[7, :16, :20]
    features, _ = pattern_cosines(patterns)
    assert features[2, 3, 7] == pytest.approx(1, abs=1e-5)
    assert abs(features[4:8, 3, 7]).max() < 0.5
    for pixels in shown:
        assert pixels.shape == (32 * 40, K)
        np.testing.assert_allclose(pixels.mean(axis=1), 0, atol=1e-4)
        np.testing.assert_allclose(pixels.std(axis=1), 1, atol=1e-3)
    # Blurs wider than a quarter of the projector, and what does not differ, are left out.
    narrow, _ = pattern_cosines(patterns[:, :12])
    assert len(narrow) == 2 * (3 + 4 + 16 + 4 + 1)
