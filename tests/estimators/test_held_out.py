"""Frames that explain one another are held out together, and random ones as before."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.estimators.coherent import row_errors
from lightmatrix.estimators.coherent.row_errors import HeldOut, held_out_frames
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.judgement.metrics import relative_error

BASE = lm.BernoulliPatterns((16, 16), 16, seed=1).rows(0, 16).reshape(16, 16, 16)


def images(stack: NDArray[np.float32]) -> lm.ImagePatterns:
    return lm.ImagePatterns(np.asarray(stack, np.float32))


@pytest.mark.parametrize("count", [8, 16, 33, 64, 255])
def test_random_frames_are_held_out_as_ever(count: int) -> None:
    held = HeldOut.choose(lm.BernoulliPatterns((16, 16), count, seed=2))
    np.testing.assert_array_equal(held.frames, held_out_frames(count))
    np.testing.assert_array_equal(held.judged, held.frames)


@pytest.mark.parametrize("times", [2, 4, 8])
@pytest.mark.parametrize("interleaved", [True, False])
def test_a_pattern_is_held_out_each_time_it_is_shown(times: int, interleaved: bool) -> None:
    shown = np.arange(16 * times) // times if interleaved else np.arange(16 * times) % 16
    held = HeldOut.choose(images(BASE[shown]))
    assert len(held.judged) >= 2
    assert len(held.frames) == times * len(held.judged)
    others = np.delete(shown, held.frames)
    assert not np.isin(shown[held.judged], others).any()


def test_an_inverse_is_held_out_with_its_pattern() -> None:
    held = HeldOut.choose(images(np.stack([BASE, 1 - BASE], 1).reshape(-1, 16, 16)))
    assert len(held.frames) == 2 * len(held.judged) == 4
    assert set(held.frames // 2) == set(held.judged // 2)


def test_nothing_is_held_out_where_that_tests_nothing() -> None:
    lines = np.broadcast_to(BASE[:, :1], BASE.shape)
    two = np.repeat(BASE[:2], 8, axis=0)
    for patterns in (images(lines), images(two), lm.BernoulliPatterns((16, 16), 7)):
        held = HeldOut.choose(patterns)
        assert not len(held.frames)
        assert not len(held.judged)


@pytest.mark.parametrize("count", [16, 40, 48, 56, 64, 200])
def test_as_few_are_judged_as_asked(count: int) -> None:
    held = HeldOut.choose(lm.BernoulliPatterns((16, 16), count, seed=2), judged=4)
    assert len(held.judged) == min(4, count // 8)
    assert set(held.judged) <= set(held_out_frames(count))


def test_of_many_frames_the_twins_are_still_found(monkeypatch: pytest.MonkeyPatch) -> None:
    base = lm.BernoulliPatterns((16, 16), 64, seed=1).rows(0, 64).reshape(64, 16, 16)
    many = images(np.concatenate([base, base]))
    monkeypatch.setattr(row_errors, "_COMPARED", 32)
    held = HeldOut.choose(many, judged=4)
    assert len(held.frames) == 2 * len(held.judged) == 4
    assert set(held.frames % 64) == set(held.judged % 64)


@pytest.mark.parametrize("patterns", ["shown twice", "shown four times", "with inverses"])
def test_frames_that_repeat_others_do_not_lower_the_stated_error(patterns: str) -> None:
    case = draw("speckle", patterns, "intact", 16, 0)
    estimate = lm.estimate(case.capture, check=False)
    stated = OwnError(estimate).estimated
    assert stated is not None
    assert stated > 0.5 * relative_error(estimate, case.truth) > 0.1
