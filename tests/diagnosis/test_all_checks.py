"""Each fault of a capture is found and named; intact captures, of any kind, are left alone.

How often, over many captures, `python -m benchmarks.frame_checks` measures.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks import frame_checks
from lightmatrix.diagnosis.all_checks import check_capture
from lightmatrix.diagnosis.finding import KINDS, join_names
from lightmatrix.patterns.bits import BernoulliPatterns
from tests.helpers.surface import CAMERA, PROJECTOR, photographs

K = 32
PATTERNS = BernoulliPatterns(PROJECTOR, K)
DECODER = lm.Decoder(clip=255, full_scale=255)
Frames = NDArray[np.uint8]
Found = list[tuple[str, tuple[int, ...]]]


def found(
    frames: Frames,
    patterns: lm.PatternSet = PATTERNS,
    decoder: lm.Decoder = DECODER,
    **options: bool,
) -> Found:
    findings = check_capture(lm.Capture.from_arrays(patterns, frames, decoder), **options)
    assert {each.kind for each in findings} <= set(KINDS)
    assert all(each.message and each.advice for each in findings)
    return [(each.kind, each.frames) for each in findings]


def swapped(frames: Frames) -> Frames:
    order = np.arange(K)
    order[[3, 9]] = 9, 3
    return frames[order]


def lost(frames: Frames) -> Frames:
    return np.concatenate([np.delete(frames, 12, axis=0), frames[-1:]])


def blackened(frames: Frames) -> Frames:
    return np.where(np.arange(K)[:, None, None] == 5, 0, frames).astype(np.uint8)


def replaced(frames: Frames) -> Frames:
    other = frames.copy()
    other[5] = np.random.default_rng(0).permutation(other[5].ravel()).reshape(CAMERA)
    return other


def shifted(frames: Frames) -> Frames:
    return np.concatenate([frames[:16], np.roll(frames[16:], 2, axis=2)])


def coded(frames: Frames) -> Frames:
    return np.rint(255 * (frames / 255.0) ** (1 / 2.2)).astype(np.uint8)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda frames: frames, []),
        (swapped, [("order", (3, 9))]),
        (blackened, [("frame", (5,))]),
        (replaced, [("frame", (5,))]),
        (shifted, [("motion", tuple(range(16, K)))]),
        (coded, [("response", ())]),
        (lambda frames: swapped(blackened(frames)), [("order", (3, 9)), ("frame", (5,))]),
    ],
    ids=["intact", "swapped", "black", "replaced", "shifted", "coded", "swapped and black"],
)
def test_faults_are_named(fault: Callable[[Frames], Frames], expected: Found) -> None:
    assert found(fault(photographs(PATTERNS))) == expected


def test_a_lost_frame_displaces_the_rest() -> None:
    ((kind, frames),) = found(lost(photographs(PATTERNS)))
    assert kind == "order"
    assert abs(frames[0] - 12) <= 1
    assert frames == tuple(range(frames[0], 31))


def test_light_that_changes() -> None:
    beat = 1 + 0.05 * np.sin(1 + 1.3 * np.arange(K))
    assert found(photographs(PATTERNS, gain=beat)) == [("flicker", ())]
    one = np.where(np.arange(K) == 7, 1.1, 1.0)
    assert found(photographs(PATTERNS, gain=one)) == [("flicker", (7,))]


def test_only_the_order_of_frames() -> None:
    frames = photographs(PATTERNS)
    assert found(swapped(frames), order_only=True) == [("order", (3, 9))]
    assert found(blackened(frames), order_only=True) == [("frame", (5,))]
    bright = photographs(PATTERNS, exposure=20)
    assert found(bright, order_only=True) == []
    assert [kind for kind, _ in found(bright)] == ["light"]


def test_few_frames_reveal_nothing() -> None:
    for count, kinds in ((11, []), (12, ["black"])):
        images = PATTERNS.images()[:count].copy()
        images[3] = 0
        frames = photographs(lm.ImagePatterns(images))
        frames[3] = frames[4]
        assert [
            kind for kind, _ in found(frames, lm.ImagePatterns(images), order_only=True)
        ] == kinds


def test_interchanged_folders() -> None:
    drawn = (PATTERNS.images() * 255).astype(np.uint8)
    noisy = lm.ImagePatterns((photographs(PATTERNS) / 255).astype(np.float32))
    assert found(drawn, noisy) == [("interchanged", ())]
    assert found(drawn, noisy, order_only=True) == [("interchanged", ())]


def test_a_bright_black_frame() -> None:
    frames = photographs(PATTERNS)
    black = lm.Decoder(clip=255, full_scale=255, black_frame=frames[0].ravel())
    assert "black" in [kind for kind, _ in found(frames, decoder=black)]


@pytest.mark.parametrize("kind", ["hadamard", "mix", "sparse"])
def test_other_patterns_are_left_alone(kind: str) -> None:
    patterns = {
        "hadamard": lm.HadamardPatterns(PROJECTOR, 48, "random", True),
        "mix": lm.make_patterns("mix", PROJECTOR, 64),
        "sparse": BernoulliPatterns(PROJECTOR, 48, 0.25),
    }[kind]
    assert found(photographs(patterns, exposure=0.5), patterns) == []


def test_colour_is_left_alone() -> None:
    grey = photographs(PATTERNS)
    colour = np.rint(grey[..., None] * np.array([1, 0.8, 0.5])).astype(np.uint8)
    assert found(colour) == []


# ---- the bundled scenes


@pytest.mark.parametrize("fault", ["two frames swapped", "JPEG at quality 60"])
def test_faults_of_a_bundled_scene_are_named(fault: str) -> None:
    draws = (draw for draw in frame_checks.draws(40, seed=5) if draw.patterns.count == 32)
    draw = next(draw for draw in draws if draw.scene == "metal")
    findings, named = frame_checks.FAULTS[fault](draw, np.random.default_rng(1))
    assert named, [each.message for each in findings]


def test_a_shift_is_named_though_photographs_seem_unrelated_to_their_patterns() -> None:
    draw = list(frame_checks.draws(7, seed=7))[-1]
    findings, named = frame_checks.FAULTS["shifted 2 px from the middle on"](
        draw, np.random.default_rng(6)
    )
    assert named, [each.message for each in findings]


def test_several_exposures_of_a_bundled_scene_are_left_alone() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    capture = lm.simulate("metal", patterns, exposure="0.4:0.5,0.1:0.5", leak=0.01, ambient=0.05)
    assert lm.check(capture) == []


def test_names_in_words() -> None:
    assert join_names(list("ab")) == "a and b"
    assert join_names(list("abc")) == "a, b and c"
    assert join_names(["a"]) == "a"
    assert join_names(list("abcde")) == "a, b, c, d and e"
    assert join_names(list("abcdefg")) == "a, b, c, d, e and 2 more"
