"""Shifts between frames are measured, and the frame from which on they hold."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check.motion import check_motion, find_shift
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from tests.helpers.surface import PROJECTOR, photographs

K = 24


PATTERNS = BernoulliPatterns(PROJECTOR, K)


DECODER = lm.Decoder(clip=255, full_scale=255)


def survey(frames: NDArray[np.uint8], patterns: lm.PatternSet = PATTERNS) -> Survey:
    capture = lm.Capture.from_arrays(patterns, frames, DECODER)
    return Survey.take(capture.patterns, capture.frames, capture.decoder)


def found(frames: NDArray[np.uint8], doubted: tuple[int, ...] = ()) -> list[tuple[int, str]]:
    taken = survey(frames)
    odd = np.isin(np.arange(K), doubted)
    names = [f"frame {k}" for k in range(K)]
    rows = high_variance_rows(taken)
    findings = check_motion(taken, rows, odd, names)
    assert all(each.frames == tuple(range(each.frames[0], K)) for each in findings)
    return [(each.frames[0], each.message) for each in findings]


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        ((0, 2), "(2 right)"),
        # A drift of a pixel cannot be told from a step.
        ((-1, 0), "(1 up), or drifted there"),
        ((3, -4), "(3 down, 4 left)"),
    ],
)
def test_the_shift_and_its_frame_are_measured(shift: tuple[int, int], words: str) -> None:
    frames = photographs(PATTERNS)
    frames[10:] = np.roll(frames[10:], shift, axis=(1, 2))
    ((start, message),) = found(frames)
    assert abs(start - 10) <= 1
    assert message.startswith(f"from frame {start} on, the image lies about ")
    assert message.endswith(f" {np.hypot(*shift):.2g} camera pixels away {words}")


def test_still_frames_and_short_captures_have_no_motion() -> None:
    assert found(photographs(PATTERNS)) == []
    few = BernoulliPatterns(PROJECTOR, 8)
    frames = photographs(few)
    frames[4:] = np.roll(frames[4:], 2, axis=2)
    taken = survey(frames, few)
    assert check_motion(taken, np.arange(100, 140), np.zeros(8, bool), ["x"] * 8) == []
    moved = photographs(PATTERNS)
    moved[10:] = np.roll(moved[10:], 2, axis=2)
    rows = high_variance_rows(survey(moved))
    for count, kinds in ((19, 0), (60, 1)):
        findings = check_motion(survey(moved), rows[:count], np.zeros(K, bool), ["x"] * K)
        assert len(findings) == kinds


def test_a_frame_that_is_odd_by_itself_is_no_motion() -> None:
    frames = photographs(PATTERNS)
    frames[11] = np.roll(frames[11], 2, axis=1)
    assert found(frames, doubted=(11,)) == []


# ---- images


def textured(rows: int = 40, cols: int = 44) -> NDArray[np.float32]:
    return np.random.default_rng(0).uniform(0.2, 1, (rows, cols)).astype(np.float32)


def image_shift(
    first: NDArray[np.float32], last: NDArray[np.float32], masked: int = 0
) -> tuple[int, int] | None:
    taken = survey(np.zeros((2, *first.shape), np.uint8), BernoulliPatterns((4, 4), 2))
    taken.valid[: masked * first.shape[1]] = False
    return find_shift(taken, first.ravel(), last.ravel())


def test_images_that_only_changed_are_not_shifted() -> None:
    image = textured()
    noise = np.random.default_rng(1).normal(0, 0.05, image.shape)
    assert image_shift(image, (image + noise).astype(np.float32)) is None
    light = np.linspace(0.5, 1, 44, dtype=np.float32)
    assert image_shift(image, image * light) is None
    other = np.random.default_rng(5).uniform(0.2, 1, image.shape).astype(np.float32)
    assert image_shift(image, other) is None


def test_one_part_of_the_image_does_not_decide() -> None:
    image = textured()
    moved = image.copy()
    moved[5:11, 5:11] = np.roll(image, 2, axis=1)[5:11, 5:11]
    assert image_shift(image, moved) is None


def test_masked_samples_do_not_count() -> None:
    image = textured()
    moved = image.copy()
    moved[16:] = np.roll(image, 2, axis=1)[16:]
    assert image_shift(image, moved) is None
    assert image_shift(image, moved, masked=20) == (0, 2)
