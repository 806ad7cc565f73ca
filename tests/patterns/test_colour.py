"""Patterns of a colour projector: three grids side by side, one colour image a pattern on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.errors import InputError
from lightmatrix.patterns.colour import ColourPatterns, colour_images

SHAPE = (6, 10)
RANDOM = lm.colour_bernoulli(SHAPE, 7, grey=2, seed=3)
PICTURES = colour_images(np.random.default_rng(0).integers(0, 256, (4, *SHAPE, 3)) / 255)


@pytest.mark.parametrize("patterns", [RANDOM, PICTURES])
def test_they_are_one_operator(patterns: ColourPatterns) -> None:
    random = np.random.default_rng(1)
    rows, errors = random.random((3, patterns.pixels)), random.random((3, patterns.count))
    dense = patterns.dense()
    assert dense.shape == (patterns.count, 3 * 60)
    np.testing.assert_allclose(patterns.forward(rows), rows @ dense.T)
    np.testing.assert_allclose(patterns.adjoint(errors), errors @ dense)
    some = np.array([0, 9, 10, 19, 20, 29, 30, 179])
    np.testing.assert_array_equal(patterns.columns(some), dense[:, some])
    assert (patterns.subset(np.array([3, 1])).dense() == dense[[3, 1]]).all()


def test_columns_are_red_then_green_then_blue_in_each_row_of_pixels() -> None:
    images = PICTURES.colour_images()
    wide = PICTURES.images()
    for primary in range(3):
        part = wide[:, :, 10 * primary : 10 * (primary + 1)]
        np.testing.assert_array_equal(part, images[..., primary])


def test_grey_patterns_come_first_and_the_others_differ() -> None:
    assert RANDOM.grey.tolist() == [True] * 2 + [False] * 5
    assert lm.colour_bernoulli(SHAPE, 64).grey.sum() == 16
    assert lm.colour_bernoulli(SHAPE, 10).grey.sum() == 5
    coloured = RANDOM.colour_images()[2:]
    assert (coloured[..., 0] != coloured[..., 1]).mean() > 0.3
    with pytest.raises(InputError, match="leave one at least"):
        lm.colour_bernoulli(SHAPE, 4, grey=4)
    with pytest.raises(InputError, match="as many patterns"):
        ColourPatterns(RANDOM.red, RANDOM.green, PICTURES.blue)


@pytest.mark.parametrize("patterns", [RANDOM, PICTURES])
def test_a_folder_holds_colour_images(patterns: ColourPatterns, tmp_path: Path) -> None:
    lm.write_patterns(tmp_path / "p", patterns)
    image = lm.read_image(tmp_path / "p" / "pattern_0003.png")
    np.testing.assert_array_equal(image, np.rint(255 * patterns.colour_images()[3]))
    read = lm.read_patterns(tmp_path / "p")
    assert isinstance(read, ColourPatterns)
    np.testing.assert_array_equal(read.dense(), patterns.dense())
    assert read.digest == patterns.digest
    with pytest.raises(InputError, match="leave out one"):
        lm.write_patterns(tmp_path / "q", patterns, colour="red")


def test_blocks_stay_within_a_primary() -> None:
    coarse = PICTURES.coarse((3, 5))
    expected = PICTURES.colour_images().reshape(4, 2, 3, 2, 5, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(coarse.colour_images(), expected, rtol=1e-5)
