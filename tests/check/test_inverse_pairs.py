"""Patterns with their inverses: what their sums show of order, single frames, light and motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check.all_checks import missing_places
from lightmatrix.check.survey import Survey
from lightmatrix.patterns.pattern_set import ImagePatterns
from tests.helpers.surface import CAMERA, PROJECTOR, photographs

DECODER = lm.Decoder(clip=255, full_scale=255)


def gray_code() -> ImagePatterns:
    """Column and row stripes, each with its inverse; white and black at the end: 22 patterns."""
    rows, cols = np.indices(PROJECTOR)
    images = []
    for place, size in ((cols, PROJECTOR[1]), (rows, PROJECTOR[0])):
        for bit in reversed(range((size - 1).bit_length())):
            stripe = ((place ^ (place >> 1)) >> bit & 1).astype(float)
            images += [stripe, 1 - stripe]
    images += [1 - images[9], images[9], np.ones(PROJECTOR), np.zeros(PROJECTOR)]
    return ImagePatterns(np.array(images, np.float32))


PATTERNS = gray_code()


K = PATTERNS.count


def found(frames: NDArray[np.uint8]) -> list[tuple[str, tuple[int, ...]]]:
    capture = lm.Capture.from_arrays(PATTERNS, frames, DECODER)
    findings = [(each.kind, each.frames) for each in lm.check(capture)]
    # Stripes never tell rows with several footprints.
    assert findings.pop() == ("stripes", ())
    return findings


def ordered(*swap: int) -> NDArray[np.int64]:
    order = np.arange(K)
    order[list(swap)] = swap[::-1]
    return order


@pytest.mark.parametrize("swap", [(2, 7), (4, 13)])
def test_swapped_frames_are_named(swap: tuple[int, int]) -> None:
    assert ("order", swap) in found(photographs(PATTERNS, exposure=0.5)[ordered(*swap)])


def test_a_stripe_in_place_of_white_is_out_of_order() -> None:
    # Sums do not tell whether stripes and white were swapped, or their inverses.
    order = found(photographs(PATTERNS, exposure=0.5)[ordered(6, 20)])
    assert [frames in ((6, 20), (7, 21)) for kind, frames in order if kind == "order"] == [True]


def test_a_black_frame_and_one_that_shows_something_else_are_named() -> None:
    frames = photographs(PATTERNS, exposure=0.5)
    right = frames[6].copy()
    frames[6] = 1
    assert found(frames) == [("frame", (6,))]
    frames[6] = np.random.default_rng(0).permutation(right.ravel()).reshape(CAMERA)
    assert found(frames) == [("frame", (6, 7))]


@pytest.mark.parametrize("copied", [(6, 7), (7, 6)])
def test_a_pattern_and_its_inverse_that_are_the_same_are_both_named(
    copied: tuple[int, int],
) -> None:
    """Nothing tells which of the two is the copy."""
    frames = photographs(PATTERNS, exposure=0.5)
    frames[copied[1]] = frames[copied[0]]
    assert found(frames) == [("order", (6, 7))]


@pytest.mark.parametrize("start", [8, 9])
def test_motion_is_found_to_the_pair(start: int) -> None:
    frames = photographs(PATTERNS, exposure=0.5)
    frames[start:] = np.roll(frames[start:], 2, axis=2)
    ((kind, moved),) = found(frames)
    assert kind == "motion"
    assert moved == tuple(range(moved[0], K))
    assert moved[0] in (8, 10)
    # Motion at the beginning and end of one pair only is none.
    frames = photographs(PATTERNS, exposure=0.5)
    frames[8:10] = np.roll(frames[8:10], 2, axis=2)
    assert "motion" not in [kind for kind, _ in found(frames)]


@pytest.mark.parametrize("place", [3, 10, 17])
def test_a_missing_frame_is_named_with_its_inverse_at_most(place: int) -> None:
    frames = np.delete(photographs(PATTERNS, exposure=0.5), place, axis=0)
    capture = lm.Capture.from_arrays(PATTERNS.subset(np.arange(K - 1)), frames, DECODER)
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder)
    named = missing_places(replace(survey, patterns=PATTERNS))
    assert place in named
    assert set(named) <= {place, place ^ 1}


def test_the_last_frame_is_missing_as_well_as_any() -> None:
    frames = photographs(PATTERNS, exposure=0.5)[:-1]
    capture = lm.Capture.from_arrays(PATTERNS.subset(np.arange(K - 1)), frames, DECODER)
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder)
    assert missing_places(replace(survey, patterns=PATTERNS)) == (K - 1,)


@pytest.mark.parametrize("first", [4, 9])
def test_a_thing_that_moves_within_the_scene_is_named(first: int) -> None:
    frames = photographs(PATTERNS, exposure=0.5)
    rows, cols = frames.shape[1:]
    part = np.s_[first:, rows // 3 : rows // 3 + rows // 4, cols // 3 : cols // 3 + cols // 4]
    still = found(frames)
    frames[part] = np.roll(frames, (3, 5), axis=(1, 2))[part]
    moved = [kind_frames for kind_frames in found(frames) if kind_frames not in still]
    assert [kind for kind, _ in moved] == ["motion"]
    assert moved[0][1][0] in (first - 1, first)
