"""Patterns that cannot reveal all of T, and folders that were exchanged."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.diagnosis.pattern_faults import check_distinguishable, check_interchanged
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns

K = 12
RANDOM = BernoulliPatterns((10, 10), K).images()


def message(images: NDArray[np.floating]) -> str:
    found = check_distinguishable(ImagePatterns(images.astype(np.float32)))
    assert len(found) < 2
    assert {each.kind for each in found} <= {"patterns", "stripes"}
    return found[0].message if found else ""


def test_random_patterns_reveal_all() -> None:
    assert message(RANDOM) == ""


def test_stripes_in_both_directions_do_not() -> None:
    rows = np.repeat(RANDOM[:, :, :1], 10, axis=2)
    cols = np.repeat(RANDOM[:, :1], 10, axis=1)
    for stripes in (rows, cols, np.concatenate([rows, cols])):
        assert "along rows or along columns only" in message(stripes)
    # One pattern that varies along both is enough, but by more than 2 %.
    both = 0.9 * np.concatenate([rows, cols])
    both[5, 3, 3] += 0.01
    assert "along rows or along columns only" in message(both)
    both[5, 3, 3] += 0.02
    assert "along rows or along columns only" not in message(both)


def test_stripes_are_a_note_and_twins_a_fault() -> None:
    stripes = np.repeat(RANDOM[:, :1], 10, axis=1).astype(np.float32)
    (note,) = check_distinguishable(ImagePatterns(stripes))
    (fault,) = check_distinguishable(ImagePatterns(np.ones((K, 10, 10), np.float32)))
    assert note.is_note
    assert not fault.is_note


def test_uniform_patterns_and_single_lines_are_no_stripes() -> None:
    assert "look like another" in message(np.ones((K, 10, 10)))
    assert message(np.random.default_rng(0).random((K, 1, 30))) == ""


def test_a_fifth_of_the_pixels_may_be_alike() -> None:
    for alike, fault in ((18, False), (24, True)):
        images = RANDOM.copy().reshape(K, -1)
        images[:, :alike:2] = images[:, 1:alike:2]
        found = message(images.reshape(K, 10, 10))
        assert bool(found) == fault
        if fault:
            assert f"{alike} % of the projector pixels look like another" in found


def interchanged(patterns: lm.PatternSet, frames: NDArray[np.uint8]) -> bool:
    camera = lm.Decoder(clip=255, full_scale=255)
    capture = lm.Capture.from_arrays(patterns, frames, camera)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    found = check_interchanged(taken)
    assert [each.kind for each in found] in ([], ["interchanged"])
    return bool(found)


@pytest.mark.parametrize("frames", [3, 12])
def test_exchanged_folders(frames: int) -> None:
    noisy = np.random.default_rng(0).random((frames, 10, 10)).astype(np.float32)
    drawn = (RANDOM[:frames] * 255).astype(np.uint8)
    photographs = (noisy * 255).astype(np.uint8)
    assert interchanged(ImagePatterns(noisy), drawn)
    assert not interchanged(ImagePatterns(noisy), photographs)
    assert not interchanged(ImagePatterns(RANDOM[:frames]), drawn)
    assert not interchanged(BernoulliPatterns((10, 10), frames), drawn)


def test_how_many_greys_are_few_and_many() -> None:
    drawn = np.arange(100) % 4 * np.ones((K, 1))
    noisy = np.arange(100) % 24 / 24 * np.ones((K, 1))
    shape = (K, 10, 10)

    def both(photographs: NDArray[np.floating], patterns: NDArray[np.floating]) -> bool:
        images = ImagePatterns(patterns.reshape(shape).astype(np.float32))
        return interchanged(images, photographs.reshape(shape).astype(np.uint8))

    assert both(drawn, noisy)
    assert not both(np.arange(100) % 5 * np.ones((K, 1)), noisy)
    assert not both(drawn, np.arange(100) % 23 / 24 * np.ones((K, 1)))
    # Only the first four are looked at.
    odd = drawn.copy()
    odd[4] = np.arange(100)
    assert both(odd, noisy)
    odd[3] = np.arange(100)
    assert not both(odd, noisy)
