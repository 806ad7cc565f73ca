"""Too much light, too little, and black and white frames that are not so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.diagnosis.levels import check_light_level, check_plain_frames, unseen_pixels
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns

K, SIDE = 12, 20
CAMERA = lm.Decoder(clip=255, full_scale=255)


def survey(frames: NDArray[np.uint8], decoder: lm.Decoder = CAMERA) -> Survey:
    patterns = BernoulliPatterns((4, 4), len(frames))
    capture = lm.Capture.from_arrays(patterns, frames, decoder)
    return Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)


def kinds(frames: NDArray[np.uint8], decoder: lm.Decoder = CAMERA) -> list[str]:
    return [each.kind for each in check_light_level(survey(frames, decoder))]


def random_frames(top: int = 200) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, top + 1, (K, SIDE, SIDE)).astype(np.uint8)


def test_frames_with_enough_light_pass() -> None:
    assert kinds(random_frames()) == []


def test_two_thirds_of_the_samples_may_clip() -> None:
    for share, found in ((0.64, []), (0.69, ["light"])):
        frames = random_frames()
        frames[:, : round(SIDE * share)] = 255
        # Rows of the image: 12.8 of 20 and 13.8 of 20.
        frames[:, : int(SIDE * share), :] = 255
        assert kinds(frames) == found


@pytest.mark.parametrize("black", [0, 10])
def test_24_levels_above_black_are_enough(black: int) -> None:
    decoder = lm.Decoder(clip=255, full_scale=255, black_level=black)
    for levels, found in ((22, ["light"]), (26, [])):
        frames = black + np.minimum(random_frames(2 * levels), levels)
        assert kinds(frames.astype(np.uint8), decoder) == found


def test_levels_are_counted_at_the_longest_exposure() -> None:
    exposure = np.where(np.arange(K) % 2, 0.25, 1.0)
    decoder = lm.Decoder(clip=255, full_scale=255, exposure=exposure)
    frames = random_frames(20)
    frames[1::2] //= 4
    check = check_light_level(survey(frames, decoder))
    assert [each.kind for each in check] == ["light"]
    assert "reach 20 raw levels" in check[0].message


def test_floats_have_no_levels() -> None:
    frames = (random_frames() / 255 / 20).astype(np.float32)
    assert kinds(frames, lm.Decoder(clip=1, full_scale=1)) == []  # type: ignore[arg-type]


def test_nothing_counts_where_all_is_masked() -> None:
    masked = replace(survey(random_frames()), valid=np.zeros(SIDE * SIDE, bool))
    found = check_light_level(masked)
    assert [each.kind for each in found] == ["light"]
    assert "no camera pixel counts" in found[0].message


def test_pixels_that_hardly_vary_have_not_seen_the_projector() -> None:
    frames = random_frames()
    span = np.linspace(0, 200, K)
    # Less than 5 % of 200; more; always clipped; fewer than 3 levels.
    frames[:, 0, 0] = 50 + 0.04 * span
    frames[:, 0, 1] = 50 + 0.06 * span
    frames[:, 0, 2] = 255
    frames[:, 0, 3] = 50
    assert np.flatnonzero(unseen_pixels(survey(frames))).tolist() == [0, 3]
    dim = np.zeros_like(frames)
    dim[:] = np.linspace(0, 30, K).astype(np.uint8)[:, None, None]
    dim[:, 1, 1] = np.arange(K) % 3
    dim[:, 1, 2] = np.arange(K) % 5
    assert np.flatnonzero(unseen_pixels(survey(dim))).tolist() == [SIDE + 1]


def test_a_tenth_of_the_pixels_must_see_the_projector() -> None:
    for rows, found in ((1, ["unseen"]), (3, [])):
        frames = np.full((K, SIDE, SIDE), 20, np.uint8)
        frames[:, :rows] = random_frames()[:, :rows]
        assert kinds(frames) == found


# ---- black and white frames


def plain(
    level: float,
    white: float,
    *,
    patterns: tuple[float, float] = (0.0, 1.0),
    clips: bool = False,
) -> list[str]:
    """Findings if the frames of a black and of a white pattern lie there in each pixel's range."""
    generator = np.random.default_rng(1)
    images = generator.integers(0, 2, (K, 4, 4)).astype(np.float32)
    images[3], images[7] = patterns
    frames = generator.choice([20, 220], (K, SIDE, SIDE))
    frames[0], frames[1] = 20, 220
    frames[3], frames[7] = 20 + 200 * level, 20 + 200 * white
    if clips:
        frames[7, 0, 0] = 255
    capture = lm.Capture.from_arrays(ImagePatterns(images), frames.astype(np.uint8), CAMERA)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    found = check_plain_frames(taken, np.arange(40), [f"frame {k}" for k in range(K)])
    assert all(each.frames in ((3,), (7,)) for each in found)
    return [each.kind for each in found]


def test_black_and_white_frames_lie_at_the_ends_of_the_range() -> None:
    assert plain(0.0, 1.0) == []
    assert plain(0.12, 0.88) == []
    assert plain(0.2, 1.0) == ["black"]
    assert plain(0.0, 0.8) == ["white"]
    assert plain(0.2, 0.8) == ["black", "white"]
    # Nearly black and white patterns count as such, others do not.
    assert plain(0.2, 0.8, patterns=(0.015, 0.985)) == ["black", "white"]
    assert plain(0.2, 0.8, patterns=(0.03, 0.97)) == []


def test_frames_that_clip_may_be_white() -> None:
    assert plain(0.0, 0.8, clips=True) == []


def test_a_black_frame_must_be_the_darkest() -> None:
    frames = 40 + random_frames(150)
    names = ["x"] * K
    for level, found in ((40, []), (50, []), (90, ["black"])):
        decoder = replace(CAMERA, black_frame=np.full(SIDE * SIDE, level, np.float32))
        taken = replace(survey(frames), decoder=decoder)
        assert [f.kind for f in check_plain_frames(taken, np.arange(40), names)] == found
    # Without a black frame nothing is said of it.
    bright = replace(survey(frames), decoder=replace(CAMERA, black_level=90))
    assert check_plain_frames(bright, np.arange(40), names) == []
