"""Frames, masks and black frames in memory may be anything that NumPy makes an array of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm

COUNT, SHAPE = 4, (3, 5)
PATTERNS = lm.BernoulliPatterns((8, 8), COUNT)
FRAMES = np.arange(60, dtype=np.uint8).reshape(COUNT, *SHAPE)
DECODER = lm.Decoder(255, 255)


class Tensor:
    """What other libraries' arrays look like to NumPy."""

    def __init__(self, values: NDArray[Any]) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self.values, dtype)


def samples(frames: Any, **options: Any) -> NDArray[np.float32]:
    return lm.Capture.from_arrays(PATTERNS, frames, DECODER, **options).samples().values


@pytest.mark.parametrize("form", [np.ndarray.tolist, Tensor, lambda a: a[::-1].copy()[::-1]])
def test_array_likes_are_frames(form: Any) -> None:
    np.testing.assert_array_equal(samples(form(FRAMES)), samples(FRAMES))


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (FRAMES * 1j, "frames of type complex128"),
        (FRAMES.astype(str), "frames of type <U"),
        (FRAMES.astype(object), "frames of type object"),
        (None, "frames of type object"),
        ([[1], [1, 2]], "frames of type object"),
        (FRAMES.reshape(COUNT, -1), "frames of shape (4, 15)"),
        (np.uint8(3), "frames of shape ()"),
    ],
)
def test_what_holds_no_frames_is_refused(frames: Any, words: str) -> None:
    with pytest.raises(lm.InputError) as refused:
        samples(frames)
    assert words in refused.value.message


def test_a_mask_of_numbers_leaves_out_zeros() -> None:
    mask = np.ones(SHAPE, bool)
    mask[1, 2] = False
    forms: list[Any] = [mask.astype(int), mask * 0.5, mask.tolist()]
    for form in forms:
        capture = lm.Capture.from_arrays(PATTERNS, FRAMES, DECODER, mask=form)
        np.testing.assert_array_equal(capture.mask, mask)
    with pytest.raises(lm.InputError, match="values of a mask that are not all finite"):
        samples(FRAMES, mask=np.where(mask, 1, np.nan))


def test_a_black_frame_of_another_size_is_refused() -> None:
    decoder = lm.Decoder(255, 255, black_frame=np.zeros(14, np.uint8))
    with pytest.raises(lm.InputError, match="a black frame of 14 samples for images of 15"):
        lm.Capture.from_arrays(PATTERNS, FRAMES, decoder)


def test_imaginary_parts_are_not_dropped() -> None:
    patterns: Any = np.ones((2, 3, 4)) * 1j
    with pytest.raises(lm.InputError, match="patterns of type complex"):
        lm.ImagePatterns(patterns)
    with pytest.raises(lm.InputError, match="camera lights of type complex"):
        lm.truth("metal").transport().dual(np.ones((64, 64)) * 1j)
    with pytest.raises(lm.InputError, match="an image of type complex"):
        lm.write_image("a.png", np.ones((3, 4)) * 1j)
