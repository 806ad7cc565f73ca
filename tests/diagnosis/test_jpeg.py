"""JPEG is recognised by its quality or its steps, and lossless photographs are left alone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.fft import dctn, idctn

import lightmatrix as lm
from lightmatrix.diagnosis import jpeg
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.patterns.bits import BernoulliPatterns

K = 12


def smooth(count: int = 4, seed: int = 0) -> NDArray[np.uint8]:
    generator = np.random.default_rng(seed)
    levels = np.cumsum(generator.normal(0, 6, (count, 96, 96)), axis=2) + 128
    return np.rint(levels.clip(0, 255)).astype(np.uint8)


def compressed(frames: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    saved = [encode_image(f, "jpeg", quality=quality) for f in frames]
    return np.stack([decode_image(each) for each in saved])


def blocks_of(frames: NDArray[np.uint8]) -> NDArray[np.floating]:
    return jpeg._blocks(frames[:, None].astype(np.float32))


@pytest.mark.parametrize("quality", [30, 60, 90])
def test_the_quality_is_measured(quality: int) -> None:
    measured = jpeg.likely_quality(blocks_of(compressed(smooth(), quality)))
    assert measured is not None
    assert abs(measured - quality) <= 2


@pytest.mark.parametrize("quality", [*range(1, 100, 7), 49, 51, 95])
def test_the_steps_are_those_of_libjpeg(quality: int) -> None:
    saved = encode_image(smooth(1)[0], "jpeg", quality=quality)
    with Image.open(io.BytesIO(saved)) as image:
        table = image.quantization[0]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(np.reshape(table, (8, 8)), jpeg._steps(quality))


def test_lossless_photographs_have_no_quality() -> None:
    assert jpeg.likely_quality(blocks_of(smooth())) is None
    few = blocks_of(compressed(smooth(), 60))
    assert jpeg.likely_quality(few[:39]) is None
    assert jpeg.likely_quality(few[:60]) is not None


def rounded(step: float, fine: float = 0, frequencies: int = 64) -> NDArray[np.float64]:
    """Blocks whose first coefficients, row by row, are rounded to a step; the others to `fine`."""
    blocks = np.random.default_rng(0).normal(128, 20, (400, 8, 8))
    coefficients = dctn(blocks, axes=(1, 2), norm="ortho")
    flat = coefficients.reshape(-1, 64)
    flat[:, :frequencies] = step * np.rint(flat[:, :frequencies] / step)
    if fine:
        flat[:, frequencies:] = fine * np.rint(flat[:, frequencies:] / fine)
    return np.rint(idctn(coefficients, axes=(1, 2), norm="ortho").clip(1, 254))


def test_steps_of_an_unknown_table_are_measured() -> None:
    assert jpeg.comb_step(rounded(11)) in (11, 12)
    assert jpeg.comb_step(rounded(11, frequencies=40)) in (11, 12)
    assert jpeg.comb_step(rounded(11, fine=7, frequencies=50)) in (11, 12)
    # Less than half of the frequencies on combs.
    assert jpeg.comb_step(rounded(11, frequencies=30)) is None
    assert jpeg.comb_step(np.random.default_rng(0).normal(128, 20, (400, 8, 8))) is None


def test_levels_at_the_ends_lie_on_no_comb() -> None:
    assert jpeg.comb_step(np.full((50, 8, 8), 255.0)) is None
    blocks = rounded(11)
    cut = np.full_like(blocks, 255)
    cut[:, 0, 0] = 0
    assert jpeg.comb_step(np.concatenate([blocks, cut])) in (11, 12)


def test_blocks_are_those_of_the_image() -> None:
    image = np.arange(20 * 18, dtype=np.float64).reshape(1, 1, 20, 18)
    blocks = jpeg._blocks(image)
    corners = sorted(blocks[:, 0, 0])
    assert corners == [0, 8, 144, 152]
    first = blocks[blocks[:, 0, 0].argmin()]
    np.testing.assert_array_equal(first, image[0, 0, :8, :8])
    image[0, 0, :8, :8] = 5
    image[0, 0, 0, 0] = 7
    assert len(jpeg._blocks(image)) == 3


def test_the_luminance_of_colour() -> None:
    colour = np.zeros((1, 1, 2, 2, 3))
    colour[..., 1] = 100
    np.testing.assert_allclose(jpeg._luminance(colour), 58.7)
    colour[..., 0], colour[..., 2] = 10, 50
    np.testing.assert_allclose(jpeg._luminance(colour), 2.99 + 58.7 + 5.7)
    assert jpeg._luminance(colour[..., :1]).shape == (1, 1, 2, 2)


def test_words_and_which_frames_are_looked_at() -> None:
    def check(frames: NDArray[np.generic], name: str = "a.png") -> list[str]:
        top = 255 if frames.dtype == np.uint8 else 65535
        camera = lm.Decoder(clip=top, full_scale=top)
        patterns = BernoulliPatterns((4, 4), len(frames))
        capture = lm.Capture.from_arrays(patterns, frames, camera)
        survey = Survey.take(capture.patterns, capture.frames, capture.decoder)
        return [each.message for each in jpeg.check_jpeg(survey, [name])]

    frames = compressed(smooth(), 60)
    assert check(frames) == [
        "the photographs went through JPEG of quality 60, whatever their files are now"
    ]
    assert check(frames, "A.JPG") == ["the photographs went through JPEG of quality 60"]
    assert check(frames.astype(np.uint16)) == []
    other_table = rounded(11).reshape(4, 10, 10, 8, 8).swapaxes(2, 3).reshape(4, 80, 80)
    (message,) = check(other_table.astype(np.uint8))
    assert message.startswith("the photographs went through JPEG with steps of about 1")
    assert check(frames[:, :7]) == []
    assert check(smooth()) == []
