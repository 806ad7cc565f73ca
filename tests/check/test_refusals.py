"""Captures from which no estimate can come are refused, with the reason."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check import refusals
from lightmatrix.check.finding import Finding
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable
from lightmatrix.patterns.pattern_set import ImagePatterns

K = 6
IMAGES = np.random.default_rng(0).random((K, 4, 5), np.float32)
FRAMES = np.random.default_rng(0).integers(0, 200, (K, 8, 8)).astype(np.uint8)


def capture(
    images: NDArray[np.floating] = IMAGES,
    frames: NDArray[np.integer] = FRAMES,
    **levels: float | NDArray[np.floating],
) -> lm.Capture:
    decoder = lm.Decoder(**{"clip": 255, "full_scale": 255, **levels})  # type: ignore[arg-type]
    patterns = ImagePatterns(np.asarray(images, np.float32))
    return lm.Capture.from_arrays(patterns, frames[: len(images)], decoder)


def test_good_captures_pass() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refuse_unusable(capture())


def test_patterns_that_reveal_nothing_are_refused() -> None:
    flat = np.linspace(0, 0.9, K)[:, None, None] * np.ones((K, 4, 5))
    for images, words in (
        (IMAGES[:1], "1 frame only"),
        (IMAGES[:, :1, :1], "1 x 1 pixels"),
        (flat, "no pattern varies"),
        (flat + 1e-7 * IMAGES, "no pattern varies"),
        (np.repeat(IMAGES[:1], K, axis=0), "all patterns are the same"),
    ):
        with pytest.raises(lm.InputError, match=words):
            refuse_unusable(capture(images))
    # One pattern that varies is enough, and one that differs.
    flat[4] = IMAGES[4]
    refuse_unusable(capture(flat))
    equal = np.repeat(IMAGES[:1], K, axis=0)
    equal[5, 0, 0] *= 0.99
    refuse_unusable(capture(equal))
    # One row of projector pixels is a projector.
    refuse_unusable(capture(IMAGES[:, :1]))


@pytest.mark.parametrize("black", [0, 12])
def test_dark_frames_are_refused(black: int) -> None:
    dark = (FRAMES % 3 + black).astype(np.uint8)
    with pytest.raises(lm.InputError, match="all images are dark"):
        refuse_unusable(capture(frames=dark, black_level=black))
    dark[2, 3, 3] = black + 3
    refuse_unusable(capture(frames=dark, black_level=black))
    floats = np.full((K, 8, 8), 1e-7, np.float32)
    with pytest.raises(lm.InputError, match="all images are dark"):
        refuse_unusable(capture(frames=floats, clip=1, full_scale=1))  # type: ignore[arg-type]
    refuse_unusable(capture(frames=1e4 * floats, clip=1, full_scale=1))  # type: ignore[arg-type]


def test_a_pixel_that_clips_without_light_decides_nothing() -> None:
    dark, lit = (FRAMES % 3).astype(np.uint8), FRAMES.copy()
    dark[:, 2, 3] = lit[:, 2, 3] = 255
    black = np.zeros(64)
    black[19] = 255
    refuse_unusable(capture(frames=lit, black_frame=black))
    with pytest.raises(lm.InputError, match="all images are dark"):
        refuse_unusable(capture(frames=dark, black_frame=black))
    # At eight times its exposure, what the black frame has at the same place is beyond the clip.
    black, exposure = np.full(64, 40.0), np.array([8.0, 1, 1, 1, 1, 1])
    refuse_unusable(capture(frames=lit, exposure=exposure, black_frame=black, black_exposure=1.0))


def test_clipped_and_masked_frames_are_refused() -> None:
    clipped = np.full((K, 8, 8), 255, np.uint8)
    clipped[:3, 0, 0] = 3
    with pytest.raises(lm.InputError, match=r"99\.2 % of the samples are clipped"):
        refuse_unusable(capture(frames=clipped))
    clipped[3, 0, 0] = 3
    refuse_unusable(capture(frames=clipped))
    masked = replace(capture(), mask=np.zeros((8, 8), bool))
    with pytest.raises(lm.InputError, match="masked"):
        refuse_unusable(masked)


@pytest.mark.parametrize("kind", ["order", "unrelated", "interchanged"])
def test_only_what_does_not_follow_the_patterns_is_refused(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Finding("flicker", (), "the light varies", "a steady lamp")
    monkeypatch.setattr(refusals, "check_capture", lambda capture: [other])
    assert refuse_unordered(capture()) == [other]
    wrong = Finding(kind, (1, 2), "frame 1 and frame 2 look swapped", "swap them")
    monkeypatch.setattr(refusals, "check_capture", lambda capture: [other, wrong])
    with pytest.raises(lm.InputError, match="look swapped") as caught:
        refuse_unordered(capture())
    assert caught.value.hint == "swap them; check=False takes them as they are"
