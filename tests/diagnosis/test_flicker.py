"""Changes of the light are measured exactly, and reported from the stated sizes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.diagnosis.prediction import FramePrediction
from lightmatrix.diagnosis.wrong_frames import brightness_changes, check_flicker
from tests.helpers.predictions import prediction

K = 12
NAMES = [f"frame {k}" for k in range(K)]


def findings(
    change: NDArray[np.float64] | list[float], error: float = 0.001
) -> list[tuple[str, tuple[int, ...]]]:
    change = np.asarray(change)
    frames = np.arange(len(change))
    found = check_flicker(change, np.full(len(change), error), frames, NAMES)
    return [(each.kind, each.frames) for each in found]


def test_the_change_of_a_frame_and_its_error_are_measured() -> None:
    example = prediction(rows=60, frames=K, noise=0.01)
    gain = np.ones(K)
    gain[3] = 1.03
    bright = prediction(rows=60, frames=K, noise=0.01, gain=gain)
    change, error = brightness_changes(bright)
    assert change[3] == pytest.approx(0.03, abs=4 * error[3])
    assert np.abs(np.delete(change, 3)).max() < 0.02
    # The error is the spread over many draws of the noise.
    draws = np.array(
        [
            brightness_changes(prediction(rows=60, frames=K, noise=0.01, seed=seed))[0]
            for seed in range(60)
        ]
    )
    assert np.median(brightness_changes(example)[1]) == pytest.approx(draws.std(), rel=0.25)


def test_rows_that_miss_the_same_light_are_one_witness() -> None:
    example = prediction(rows=64, frames=K, noise=0.01)
    part = np.arange(64) // 4
    shared = np.random.default_rng(3).normal(0, 0.05, (16, K))[part]
    missed = replace(example, observed=example.observed + shared, part=part)
    change, error = brightness_changes(missed)
    assert (np.abs(change) < 4 * error).all()
    alone = brightness_changes(replace(missed, part=np.arange(64)))[1]
    assert np.median(error) > 1.5 * np.median(alone)


def test_what_badly_predicted_rows_miss_must_be_mostly_a_change() -> None:
    gain = 1 + 0.05 * np.where(np.arange(K) % 2, 1.0, -1.0)
    for noise, changes in ((0.01, True), (0.2, False)):
        example = prediction(rows=400, frames=K, noise=noise, gain=gain)
        for miss, known in ((0.03, True), (0.05, changes)):
            change, error = brightness_changes(replace(example, miss=np.full(400, miss)))
            assert (np.isfinite(error) & (change != 0)).all() == known
    # One frame is mostly a change, but all frames together miss other light.
    alone = np.where(np.arange(K) == 3, 1.3, 1.0)
    one = prediction(rows=400, frames=K, noise=0.01, gain=alone)
    assert brightness_changes(replace(one, miss=np.full(400, 0.06)))[0][3] > 0.05
    other = np.random.default_rng(5).normal(0, 0.2, (400, K)) * (np.arange(K) != 3)
    spoilt = replace(one, observed=one.observed + other, miss=np.full(400, 0.06))
    assert (brightness_changes(spoilt)[0] == 0).all()


def test_dark_untrusted_and_odd_samples_do_not_count() -> None:
    gain = np.ones(K)
    gain[3] = 1.1
    example = prediction(rows=60, frames=K, noise=0.01, gain=gain)
    plain, _ = brightness_changes(example)
    observed, trusted = example.observed.copy(), example.trusted.copy()
    most = example.expected.max(axis=1, keepdims=True)
    observed[example.expected < 0.29 * most] += 0.5
    observed[0, 5], trusted[0, 5] = 9, False
    observed[example.expected[:, 6].argmax(), 6] = 9
    spoilt = FramePrediction(observed, example.expected, trusted, example.miss, (), example.part)
    # The noise is the same: that of a few odd samples is passed over.
    spoilt.__dict__["noise"] = example.noise
    change, _ = brightness_changes(spoilt)
    assert change[:6] == pytest.approx(plain[:6], abs=2e-3)
    assert 0 < change[6] - plain[6] < 0.01


def test_frames_with_few_lit_samples_are_unknown() -> None:
    for rows, known in ((19, False), (20, True)):
        example = prediction(rows=rows, frames=K, noise=0.01)
        lit = replace(example, expected=np.ones_like(example.expected))
        change, error = brightness_changes(lit)
        assert np.isfinite(error).all() == known
        assert (change != 0).all() == known


def test_light_that_varies_in_all_frames() -> None:
    beat = np.where(np.arange(K) % 2, 1.0, -1.0)
    # The spread is 1.48 times the median deviation.
    assert findings(0.0085 * beat) == [("flicker", ())]
    assert findings(0.0075 * beat) == []
    assert findings(0.0085 * beat, error=0.0018) == []
    assert findings(0.0085 * beat, error=0.0016) == [("flicker", ())]
    # Few of them certain.
    some = 0.02 * beat
    errors = np.where(np.arange(K) < 3, 0.001, 1)
    assert check_flicker(some, errors, np.arange(K), NAMES) == []
    errors[3] = 0.001
    assert [f.kind for f in check_flicker(some, errors, np.arange(K), NAMES)] == ["flicker"]
    assert findings(0.02 * beat[:3]) == []
    assert findings(0.02 * beat[:4]) == [("flicker", ())]


def test_the_words_of_light_that_varies() -> None:
    change = 0.02 * np.where(np.arange(K) % 2, 1.0, -1.0)
    change[4] = -1
    found = check_flicker(change, np.full(K, 0.001), np.arange(K), NAMES)
    usual = 1.4826 * 0.02
    spread = 100 * np.sqrt((11 * 0.02**2 + (4 * usual) ** 2) / 12)
    assert f"by {spread:.1f} %" in found[0].message
    assert "most in frame 4, -100 %" in found[0].message


def test_single_frames() -> None:
    change = np.zeros(K)
    change[7] = 0.041
    assert findings(change) == [("flicker", (7,))]
    assert findings(-change) == [("flicker", (7,))]
    assert findings(change, error=0.0085) == []
    assert findings(change * 0.039 / 0.041) == []
    # Against what frames usually deviate by: 6 x 1.48 x 0.005 is more than 4 %.
    change += 0.005 * np.where(np.arange(K) % 2, 1.0, -1.0)
    change[7] = 0.043
    assert findings(change) == []
    change[7] = 0.05
    assert findings(change) == [("flicker", (7,))]
    found = check_flicker(change, np.full(K, 0.001), np.arange(K), NAMES)
    assert "in frame 7 (+5 %)" in found[0].message
