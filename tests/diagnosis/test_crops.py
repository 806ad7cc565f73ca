"""What is found in a rectangle of the photographs is what is found in whole photographs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm

MICRO = lm.MicroPhasePatterns((64, 64))


def stack(capture: lm.Capture) -> np.ndarray:
    return np.stack([capture.frame(k) for k in range(capture.count)])


@pytest.mark.parametrize(
    ("scene", "seed", "rows", "cols"),
    [
        # In these parts of the projector, two of the patterns are nearly the same.
        ("metal", 0, slice(3, 19), slice(0, 32)),
        ("gripper", 0, slice(3, 19), slice(0, 32)),
        ("l_objects", 1, slice(28, 60), slice(22, 34)),
    ],
)
def test_fine_stripes_that_are_alike_in_a_part_of_the_projector_accuse_nothing(
    scene: str, seed: int, rows: slice, cols: slice
) -> None:
    capture = lm.simulate(scene, MICRO, seed=seed, noise=0.003)
    part = np.ascontiguousarray(stack(capture)[:, rows, cols])
    findings = lm.check(lm.Capture.from_arrays(MICRO, part, capture.decoder))
    assert [each.kind for each in findings if each.kind in ("order", "unrelated")] == []


def test_motion_is_named_from_the_same_frame_on_in_a_crop() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 48)
    intact = lm.simulate("l_objects", patterns, noise=0.003, exposure=0.4)
    frames = stack(intact)
    frames[30:] = np.roll(frames[30:], 1, axis=2)
    capture = lm.Capture.from_arrays(patterns, frames, intact.decoder)
    whole = lm.check(capture)
    assert [each.kind for each in whole] == ["motion"]
    assert abs(whole[0].frames[0] - 30) <= 1
    assert lm.check(capture.crop((10, 20), (24, 32))) == whole
    assert lm.check(capture, crop=((40, 4), (20, 20))) == whole


def test_a_crop_is_checked_with_the_black_frame_and_the_mask_of_whole_photographs() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    capture = lm.simulate("metal", patterns, noise=0.003, black_level=6)
    generator = np.random.default_rng(0)
    black = generator.uniform(4, 8, 64 * 64).astype(np.float32)
    decoder = replace(lm.Sensor().decoder(), black_frame=black)
    mask = generator.random((64, 64)) < 0.9
    whole = lm.Capture.from_arrays(patterns, stack(capture), decoder, mask=mask)
    crop = whole.crop((8, 8), (40, 48)).crop((4, 2), (20, 20))
    assert crop.camera_shape == (20, 20)
    again = crop.whole
    assert again.camera_shape == (64, 64)
    assert again.decoder.black_frame is not None
    assert again.mask is not None
    np.testing.assert_array_equal(again.decoder.black_frame, black)
    np.testing.assert_array_equal(again.mask, mask)
    np.testing.assert_array_equal(again.samples().values, whole.samples().values)
    assert whole.whole is whole


def test_only_the_crop_must_see_light_of_the_projector() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    frames = np.full((32, 256, 256), 3, np.uint8)
    frames[:, 100:164, 100:164] = stack(lm.simulate("metal", patterns, noise=0.003, exposure=0.4))
    capture = lm.Capture.from_arrays(patterns, frames, lm.Sensor())
    assert "unseen" in [each.kind for each in lm.check(capture)]
    assert lm.check(capture.crop((100, 100), (64, 64))) == []
