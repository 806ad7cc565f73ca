"""Frames that do not show their pattern, or have other light, by what their prediction misses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.check.all_checks import check_capture
from lightmatrix.check.prediction import FramePrediction
from lightmatrix.check.wrong_frames import check_frames, wrong_frames

K, M = 16, 60


NAMES = [f"frame {k}" for k in range(K)]


def prediction(
    rows: int,
    frames: int,
    *,
    noise: float = 0.0,
    gain: NDArray[np.floating] | float = 1.0,
    seed: int = 0,
) -> FramePrediction:
    """Samples between 0.1 and 1 as expected, times a gain for each frame, and Gaussian noise."""
    expected = np.random.default_rng(17).uniform(0.1, 1, (rows, frames))
    observed = expected * gain
    observed = observed + noise * np.random.default_rng(seed).standard_normal(observed.shape)
    trusted = np.ones((rows, frames), bool)
    return FramePrediction(observed, expected, trusted, np.full(rows, 0.01), (), np.arange(rows))


def off(frame: int, share: float, rows: int = M) -> FramePrediction:
    """A frame that misses a share of its variation; the others miss 1 %."""
    example = prediction(rows=rows, frames=K)
    expected = example.expected / example.expected.std(axis=1, keepdims=True)
    variation = (expected - expected.mean(axis=1, keepdims=True)).var(axis=0) + 1e-12
    sign = np.where(np.arange(rows) % 2, 1.0, -1.0)[:, None]
    size = np.full(K, 0.01)
    size[frame] = share
    usual = expected.mean(axis=1, keepdims=True)
    variation = ((expected - usual) ** 2).mean(axis=0)
    return replace(example, expected=expected, observed=expected + sign * np.sqrt(size * variation))


@pytest.mark.parametrize(("share", "wrong"), [(0.22, False), (0.4, True), (3.0, True)])
def test_a_frame_that_misses_much_of_its_variation_is_wrong(share: float, wrong: bool) -> None:
    assert np.flatnonzero(wrong_frames(off(5, share))).tolist() == [5] * wrong


def test_light_that_is_smooth_over_the_projector_accuses_nobody() -> None:
    example = off(5, 0.01)
    part = np.arange(M) // 15
    smooth = np.where(np.arange(K) == 5, 1.0, 0.0) * np.array([1, -1, 1, -1])[part][:, None]
    missed = replace(example, observed=example.observed + 0.9 * smooth, part=part)
    assert not wrong_frames(missed).any()
    assert wrong_frames(replace(missed, part=np.arange(M)))[5]


def test_dark_frames_are_wrong_only_where_light_is_expected() -> None:
    example = prediction(rows=M, frames=K)
    # Hardly any variation is missed: the pattern is flat, and dark by itself.
    expected, observed = example.expected.copy(), example.observed.copy()
    expected[:, 5] = 0.05
    observed[:, 5] = 0.01
    assert not wrong_frames(replace(example, expected=expected, observed=observed))[5]
    expected[:, 5] = 0.075
    observed[:, 5] = 0.02
    assert wrong_frames(replace(example, expected=expected, observed=observed))[5]


def test_black_frames_and_others() -> None:
    gain = np.ones(K)
    gain[[2, 3, 4]] = 0.09, 0.11, 0.0
    example = prediction(rows=M, frames=K, gain=gain)
    wrong = np.isin(np.arange(K), [2, 3, 4])
    black, other = check_frames(example, wrong, NAMES)
    assert (black.kind, black.frames) == ("frame", (2, 4))
    assert black.message == "frame 2 and frame 4: black, although the pattern is not"
    assert (other.kind, other.frames) == ("frame", (3,))
    assert check_frames(example, np.zeros(K) > 0, NAMES) == []
    # Samples that are not trusted say nothing.
    trusted = example.trusted.copy()
    trusted[::2, 3] = False
    observed = example.observed.copy()
    observed[::2, 3] = 7
    again = replace(example, trusted=trusted, observed=observed)
    assert check_frames(again, wrong, NAMES)[1].frames == (3,)


def test_frames_are_not_called_dark_by_rows_that_should_be_dark() -> None:
    # All that is lit clips: only samples that are expected to be dark can be compared.
    generator = np.random.default_rng(0)
    lit = generator.random((M, K)) < 0.5
    light = np.where(lit, 1.0, 0.0)
    expected = light + np.where(lit, 0.0, generator.normal(0.01, 0.02, light.shape))
    example = replace(off(5, 0.01), observed=light, expected=expected, trusted=~lit)
    assert not wrong_frames(example).any()


def test_samples_that_only_their_own_frame_shows_are_not_compared() -> None:
    """One pixel at a time: no other frame tells how bright its pixel is, or whether light bends."""
    patterns = lm.ImagePatterns(np.eye(256, dtype=np.float32).reshape(256, 16, 16))
    frames = np.zeros((256, 256), np.uint8)
    frames[np.arange(256), np.arange(256)] = np.random.default_rng(0).integers(60, 250, 256)
    capture = lm.Capture.from_arrays(patterns, frames.reshape(256, 16, 16), lm.Sensor())
    assert [each.kind for each in check_capture(capture)] == ["linearity"]


def test_no_other_photograph_shows_a_pixel_that_is_lit_alone() -> None:
    """What it gives cannot be predicted from them, so its frame is not accused."""
    capture = draw("fibres", "one pixel", "intact", 32, 1).capture
    assert [each.kind for each in check_capture(capture)] == ["unlit", "linearity"]
