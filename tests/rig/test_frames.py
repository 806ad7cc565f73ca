"""The questions that each frame has to answer, one by one; none keeps an earlier pattern."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lightmatrix.rig.devices.base import Frame
from lightmatrix.rig.photograph import AveragedFrame, References, Shot

SHAPE, TOP, NOISE = (20, 30), 4095.0, 12.0


def _photograph(light: Any, seed: int) -> Any:
    draw = np.random.default_rng(seed)
    return np.rint(64 + light + NOISE * draw.standard_normal(SHAPE)).astype(np.uint16)


def _average(light: Any, count: int = 4) -> AveragedFrame:
    shots = [Shot(Frame(_photograph(light, k), 0.0, TOP), 0.01) for k in range(count)]
    mean = np.mean([shot.frame.data for shot in shots], axis=0, dtype=np.float32)
    return AveragedFrame(np.asarray(mean), shots, NOISE, 0.001)


def test_black_frames_lose_their_noise_but_neither_hot_pixels_nor_light() -> None:
    black = np.zeros(SHAPE)
    black[3, 4] = 500
    cleaned = _average(black).without_noise
    assert cleaned[3, 4] == pytest.approx(564, abs=4 * NOISE)
    assert np.unique(cleaned).size == 2
    # A gradient over the image is the room's light.
    lit = _average(np.linspace(0, 200, SHAPE[1]) + black)
    np.testing.assert_array_equal(lit.without_noise, lit.mean)


def test_what_changed_since_the_start_is_told_apart() -> None:
    light = np.random.default_rng(0).uniform(500, 2500, SHAPE)
    black, white = _average(np.zeros(SHAPE)), _average(light)
    now = References(black, white, black.mean)

    def change(light: Any, room: float = 0.0) -> str:
        before = _average(light + room).mean, _average(np.full(SHAPE, room)).mean
        return str(now.change(*before))

    assert change(light) == "None"
    assert change(light / 0.9) == "the light is 90 % of what it was"
    assert change(light, 80.0) == "the room's light changed by -2.0 % of the clip level"
    assert "did something move" in change(np.roll(light, 1, axis=1))


def test_two_photographs_that_share_a_little_of_white_or_a_pattern_do_not_agree() -> None:
    random = np.random.default_rng(1)
    white, black = 2600 + 900 * random.random(SHAPE), np.zeros(SHAPE)
    flat = np.full(SHAPE, 64, np.float32)
    unlit, lit = (replace(_average(x), mean=flat + np.float32(x)) for x in (black, white))
    references = References(unlit, lit, flat)
    own, other = (white * random.integers(0, 2, SHAPE) for _ in range(2))
    for seed in range(20):
        one, again = _photograph(own, 3 * seed), _photograph(own, 3 * seed + 1)
        assert references.agree(one, again, 0.01, [other, white, black])
        for before in (other, white):
            mixed = _photograph(0.985 * own + 0.015 * before, 3 * seed + 2)
            assert not references.agree(one, mixed, 0.01, [before])
