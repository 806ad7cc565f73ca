"""Faults of a real board under Gray code stripes are found and named.

The tests use a window of it; LIGHTMATRIX_BOARD names a folder with the whole of it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check.finding import KINDS, Finding
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.files.stacks import ImageStack

WINDOW = Path(__file__).parents[1] / "data" / "graycode-board"
BOARD = Path(os.environ.get("LIGHTMATRIX_BOARD", WINDOW))
CAMERA = lm.Decoder(clip=255, full_scale=255)
Images = NDArray[np.uint8]


def compressed(frames: Images, quality: int = 60) -> Images:
    saved = [encode_image(f, "jpeg", quality=quality) for f in frames]
    return np.stack([decode_image(each) for each in saved])


def exchanged(frames: Images, a: int, b: int) -> Images:
    order = np.arange(len(frames))
    order[[a, b]] = b, a
    return frames[order]


def kinds_and_frames(found: list[Finding]) -> list[tuple[str, tuple[int, ...]]]:
    assert {each.kind for each in found} <= set(KINDS)
    assert all(each.message and each.advice for each in found)
    return [(each.kind, each.frames) for each in found]


@pytest.fixture(scope="module")
def board() -> tuple[lm.PatternSet, Images]:
    frames = np.stack(list(ImageStack.open(BOARD / "capture_0")))
    patterns = lm.read_patterns(BOARD / "graycode_pattern")
    if BOARD == WINDOW:
        # The window sees this part of the projector; the rest would take seconds.
        patterns = lm.ImagePatterns(patterns.images()[:, 512:704, 192:464].astype(np.float32))
    return patterns, frames


def darkened(frames: Images) -> Images:
    dark = frames.copy()
    dark[9] = frames[41]
    return dark


def shifted(frames: Images) -> Images:
    late = np.roll(frames[25:], 2, axis=2)
    late[:, :, :2] = frames[25:, :, :2]
    return np.concatenate([frames[:25], late])


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda frames: frames, []),
        (lambda frames: exchanged(frames, 4, 24), [("order", (4, 24))]),
        (lambda frames: exchanged(frames, 40, 41), [("black", (41,)), ("white", (40,))]),
        (darkened, [("frame", (9,))]),
        (compressed, [("jpeg", ())]),
        (shifted, [("motion", tuple(range(26, 42)))]),
    ],
    ids=["intact", "swapped", "white and black", "black", "JPEG", "shifted"],
)
def test_faults_of_the_real_board_are_named(
    fault: Callable[[Images], Images],
    expected: list[tuple[str, tuple[int, ...]]],
    board: tuple[lm.PatternSet, Images],
) -> None:
    patterns, frames = board
    capture = lm.Capture.from_arrays(patterns, fault(frames), CAMERA)
    # Stripes never tell rows with several footprints.
    assert kinds_and_frames(lm.check(capture)) == [*expected, ("stripes", ())]
