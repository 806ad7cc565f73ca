"""Frames out of order are named; good captures, of any kind, are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis import all_checks, frame_order
from lightmatrix.diagnosis.frame_order import (
    Hypothesis,
    Misses,
    RawRows,
    find_disorder,
    find_misses,
    order_findings,
)
from lightmatrix.diagnosis.pursuit import column_scale
from lightmatrix.diagnosis.refusals import refuse_unordered, refuse_unusable
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import one_pixel_patterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from tests.helpers.surface import CAMERA, PROJECTOR, surface


def capture(
    patterns: PatternSet,
    order: Sequence[int] | NDArray[np.integer] | None = None,
    *,
    exposure: float = 1.0,
    noise: float = 0.01,
    seed: int = 0,
    diffuse: float = 0.3,
) -> Capture:
    light = patterns.forward(surface(seed, diffuse))
    sensor = Sensor(exposure, read_noise=noise)
    frames = sensor.expose(light, seed=seed).T.reshape(-1, *CAMERA)
    shown = np.arange(patterns.count) if order is None else np.asarray(order)
    return Capture.from_arrays(patterns, frames[shown], sensor)


def follow(taken: Capture) -> None:
    """Refuse a capture for the order of its frames alone."""
    for finding in find_disorder(taken.patterns, taken.tiles(), taken.rows, taken.frames.name):
        raise InputError(finding.message)


def swapped(count: int, a: int, b: int) -> NDArray[np.int64]:
    order = np.arange(count)
    order[[a, b]] = b, a
    return order


def gray_code() -> ImagePatterns:
    """Column and row stripes of all powers of two, each with its inverse, white and black."""
    rows, cols = np.indices(PROJECTOR)
    images: list[NDArray[np.float64]] = []
    for place, size in ((cols, PROJECTOR[1]), (rows, PROJECTOR[0])):
        for bit in reversed(range((size - 1).bit_length())):
            stripe = ((place ^ (place >> 1)) >> bit & 1).astype(float)
            images += [stripe, 1 - stripe]
    return ImagePatterns(np.array([*images, np.ones(PROJECTOR), np.zeros(PROJECTOR)], np.float32))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("exposure", [0.3, 2.0])
@pytest.mark.parametrize("count", [8, 16, 32, 64, 200])
def test_good_captures_pass(count: int, exposure: float, seed: int) -> None:
    for density in (0.5, 0.1):
        patterns = BernoulliPatterns(PROJECTOR, count, density, seed)
        follow(capture(patterns, exposure=exposure, seed=seed, noise=0.02))


@pytest.mark.parametrize(
    "patterns",
    [
        HadamardPatterns(PROJECTOR, 48, "random", True),
        HadamardPatterns(PROJECTOR, 64, "sequency"),
        HadamardPatterns(PROJECTOR, 64, "natural"),
        gray_code(),
        one_pixel_patterns(PROJECTOR),
        ImagePatterns(np.repeat(gray_code().stack, 2, axis=0)),
    ],
    ids=["hadamard", "sequency", "natural", "gray code", "one-pixel", "each pattern twice"],
)
def test_good_captures_of_other_patterns_pass(patterns: PatternSet) -> None:
    for seed in range(3):
        follow(capture(patterns, seed=seed, exposure=1.5, noise=0.02))


def test_a_diffuse_scene_is_left_alone() -> None:
    generator = np.random.default_rng(0)
    patterns = BernoulliPatterns(PROJECTOR, 64)
    light = patterns.forward(generator.uniform(0, 2 / 320, (400, 320)))
    sensor = Sensor(read_noise=0.01)
    frames = sensor.expose(light).T.reshape(64, 20, 20)
    follow(Capture.from_arrays(patterns, frames, sensor))
    follow(Capture.from_arrays(patterns, frames[swapped(64, 3, 9)], sensor))


@pytest.mark.parametrize("exposure", [0.3, 1.5])
@pytest.mark.parametrize("count", [32, 64, 200])
def test_two_swapped_frames_are_named(count: int, exposure: float) -> None:
    for seed in range(4):
        a, b = np.sort(np.random.default_rng(seed).permutation(count)[:2])
        patterns = BernoulliPatterns(PROJECTOR, count, seed=seed)
        mixed = capture(patterns, swapped(count, a, b), exposure=exposure, seed=seed)
        with pytest.raises(InputError, match=f"frame {a} and frame {b} look swapped"):
            follow(mixed)
        refuse_unusable(mixed)


def test_swapped_stripes_of_different_width_are_noticed() -> None:
    patterns = gray_code()
    with pytest.raises(
        InputError, match=r"frame (10 shows .* frame 0|0 shows .* frame 10|0 and frame 10)"
    ):
        follow(capture(patterns, swapped(patterns.count, 0, 10)))


@pytest.mark.parametrize("first", [5, 20, 40, 55])
def test_a_missing_frame_shifts_those_after_it(first: int) -> None:
    patterns = BernoulliPatterns(PROJECTOR, 64)
    order = np.append(np.delete(np.arange(64), first), 63)
    with pytest.raises(InputError, match="after its own") as caught:
        follow(capture(patterns, order))
    if first > 32:
        assert f"from frame {first} to frame 6" in caught.value.message


def test_frames_displaced_alike() -> None:
    patterns = BernoulliPatterns(PROJECTOR, 48)
    frames = np.arange(48)
    for order, words in (
        (np.append(frames[1:], 0), "each image shows the pattern after its own"),
        (np.append(0, frames[:-1]), "each image shows the pattern before its own"),
        (frames[::-1], "the images follow the patterns backwards"),
    ):
        with pytest.raises(InputError, match=words):
            follow(capture(patterns, order))


def test_a_repeated_frame_is_named() -> None:
    patterns = BernoulliPatterns(PROJECTOR, 64)
    order = np.arange(64)
    order[30] = 29
    with pytest.raises(InputError, match="frame 30 shows the pattern of frame 29"):
        follow(capture(patterns, order))


def lost(count: int, place: int) -> NDArray[np.int64]:
    """The frames when one is missing and the last is there twice."""
    return np.append(np.delete(np.arange(count), place), count - 1)


@pytest.mark.parametrize("count", [32, 48])
def test_a_frame_missing_in_the_middle_of_few_is_noticed(count: int) -> None:
    """Neither half of the frames is enough by itself."""
    for seed in range(3):
        place = count // 2 + seed - 1
        patterns = BernoulliPatterns(PROJECTOR, count, seed=seed)
        with pytest.raises(InputError, match=r"from frame \d+ to .* after its own") as caught:
            follow(capture(patterns, lost(count, place), seed=seed))
        first = int(caught.value.message.split()[2])
        assert abs(first - place) <= 1


@pytest.mark.parametrize("renamed", [True, False], ids=["files renamed", "projector late"])
def test_displaced_frames_of_several_exposures_are_noticed(renamed: bool) -> None:
    """Their exposure goes with them where files were renamed, else it is that of their place."""
    count = 48
    exposure = np.tile([2.0, 0.5, 2.0, 0.125], count // 4)
    frames = np.arange(count)
    patterns = BernoulliPatterns(PROJECTOR, count)
    light = patterns.forward(surface())
    for order, words in (
        (frames, None),
        (swapped(count, 4, 15), "frame 4 and frame 15 look swapped"),
        (lost(count, 22), "from frame 2[123] to .* after its own"),
        (np.append(frames[1:], count - 1), "each image shows the pattern after its own"),
        (np.append(0, frames[:-1]), "each image shows the pattern before its own"),
        (frames[::-1], "backwards"),
    ):
        sensor = Sensor(exposure[order] if renamed else exposure, read_noise=0.003)
        raw = sensor.expose(np.ascontiguousarray(light[:, order])).T.reshape(count, *CAMERA)
        found = Capture.from_arrays(patterns, raw, Sensor(exposure))
        if words is None:
            follow(found)
            continue
        with pytest.raises(InputError, match=words):
            follow(found)


def test_predictions_never_use_the_frame_they_predict() -> None:
    patterns = BernoulliPatterns(PROJECTOR, 32)
    values = np.asarray(patterns.forward(surface())[::5] / 10, np.float32)
    in_order, scale = Hypothesis.in_order(32), column_scale(patterns)
    levels = np.full(values.shape, 10, np.float32)
    before = find_misses(patterns, RawRows(values, levels), in_order, scale)
    assert before.own.max() < np.log(0.3)
    # Noise in place of one frame: its own miss is that of noise, not fitted away.
    noisy = values.copy()
    noisy[:, 7] = np.random.default_rng(0).permutation(values[:, 7])
    after = find_misses(patterns, RawRows(noisy, levels), in_order, scale)
    assert after.own[7] > 0


def test_a_capture_is_judged_as_check_does(monkeypatch: pytest.MonkeyPatch) -> None:
    patterns = BernoulliPatterns(PROJECTOR, 64)
    mixed = capture(patterns, swapped(64, 4, 9))
    told = [finding for finding in lm.check(mixed) if finding.kind == "order"]
    with pytest.raises(InputError) as refused:
        refuse_unordered(mixed)
    assert refused.value.message == told[0].message
    # What the first look suspects, and the second does not confirm, is held against nobody.
    suspected = order_findings({4: 9, 9: 4}, "frame {}".format)
    monkeypatch.setattr(all_checks, "find_disorder", lambda *_: suspected)
    taken = capture(patterns)
    assert lm.check(taken) == []
    refuse_unordered(taken)


# ---- the parts of the judgement


def test_the_richest_run() -> None:
    assert frame_order._richest_run(np.array([-1.0, 2, 1, -1, 3, -2])) == (1, 5)
    assert frame_order._richest_run(np.array([1.0, 1, 1])) == (0, 3)
    assert frame_order._richest_run(np.array([-1.0, -1]))[0] == 0


@pytest.mark.parametrize(
    ("gain", "supported"),
    [
        ([1.4, 1.4, 1.4], True),
        ([1.4, 1.4], False),
        # In sum, in the mean, and with one frame that counts no more than the others.
        ([0.8, 0.8, 0.8], False),
        ([0.9, 0.9, 0.9], True),
        ([0.3] * 10, True),
        ([0.2] * 20, False),
        ([9.0, 0.3, 0.3], False),
        ([0.0, 3.0, 0.0, 1.2], True),
    ],
)
def test_runs_need_support(gain: list[float], supported: bool) -> None:
    padded = np.array([5.0, *gain, 5.0])
    assert frame_order._supported(padded, 1, len(gain) + 1) == supported


@pytest.mark.parametrize(("miss", "predictive"), [(0.7, True), (0.9, False)])
def test_predictions_must_meet_most_frames(miss: float, predictive: bool) -> None:
    logarithms = np.full((5, 5), np.log(miss))
    informative = np.ones(5, bool)
    # A frame that shows nothing known, and one that tells nothing, do not count.
    order = np.array([1, 0, 2, -1, 4])
    logarithms[2:], informative[4] = 3, False
    logarithms[2, 2] = np.log(miss)
    misses = Misses(logarithms, np.zeros((5, 5), bool), informative)
    assert frame_order._predictive(misses, order) == predictive


def test_words_for_runs() -> None:
    def words(start: int, stop: int, step: int) -> str:
        return frame_order._describe_run(start, stop, step, 10, "frame {}".format)

    every = "the images do not follow the patterns: each image shows the pattern "
    assert words(0, 8, 1) == every + "after its own"
    assert words(1, 9, -1) == every + "before its own"
    assert words(1, 8, 1).endswith(
        "from frame 1 to frame 8, each image shows the pattern after its own: is one missing?"
    )
    assert words(2, 9, -1).endswith("before its own: is one extra?")
    assert words(0, 7, 1).startswith("from frame 0 to frame 7")


def test_words_for_single_frames() -> None:
    findings = order_findings({9: 4, 4: 9, 7: 2, 1: 5, 5: 6}, "image {}".format)
    assert [(each.kind, each.frames) for each in findings] == [
        ("order", (1,)),
        ("order", (4, 9)),
        ("order", (5,)),
        ("order", (7,)),
    ]
    assert findings[1].message == "image 4 and image 9 look swapped"
    assert findings[3].message.startswith("image 7 shows the pattern of image 2:")


def test_patterns_that_are_alike_may_change_places() -> None:
    images = BernoulliPatterns(PROJECTOR, 12).images().copy()
    images[7] = images[2]
    images[7, 0, 0] = 1 - images[7, 0, 0]
    images[9] = images[3]
    images[9, :3] = 1 - images[9, :3]
    alike = frame_order._alike(ImagePatterns(images))
    assert np.argwhere(alike).tolist() == [[2, 7], [7, 2]]
    images[5] = 0.7
    images[5, 0, 0] = 0.7005
    assert np.flatnonzero(~frame_order._varied(ImagePatterns(images))).tolist() == [5]


def test_bright_rows_are_spread_over_the_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = capture(BernoulliPatterns(PROJECTOR, 16))
    bright = frame_order._bright_rows(taken.patterns, taken.tiles(), taken.rows)
    assert bright is not None
    assert 200 <= len(bright.shares) <= 210
    monkeypatch.setattr(frame_order, "_WORK", 16 * 320 * 8 * 3 * 50)
    some = frame_order._bright_rows(taken.patterns, taken.tiles(), taken.rows)
    assert some is not None
    assert 50 <= len(some.shares) <= 60
    ((_, tile),) = list(taken.tiles())
    spread = np.sort(tile.values.std(axis=1))[::-1]
    assert some.shares.std(axis=1).min() >= spread[len(spread) // 3] - 1e-6
    dark = [(0, replace(tile, values=0 * tile.values))]
    assert frame_order._bright_rows(taken.patterns, dark, taken.rows) is None


def judged(pairs: dict[tuple[int, int], float], count: int = 24) -> dict[int, int]:
    """Which frames are displaced if these (frame, pattern) miss so much, others -2 of their own."""
    logarithms = np.where(np.eye(count, dtype=bool), -2.0, 0.0)
    for place, miss in pairs.items():
        logarithms[place] = miss
    misses = Misses(logarithms, np.zeros((count, count), bool), np.ones(count, bool))
    judge = object.__new__(frame_order._Judge)
    judge.patterns = SimpleNamespace(count=count)  # type: ignore[assignment]
    judge.frames, judge.alike = np.arange(count), np.zeros((count, count), bool)
    judge.in_order = misses
    judge.misses = lambda _: misses  # type: ignore[method-assign, assignment]
    return judge.displaced_singly()


@pytest.mark.parametrize(
    ("own", "other", "shown"),
    [
        (0.0, -0.6, {3: 9, 9: 3}),
        # Not 40 % nearer to the other's prediction.
        (0.0, -0.45, {}),
        # Nearer by enough, but far from it.
        (0.4, -0.3, {}),
        # Below the least suspicion.
        (-1.9, -2.0, {}),
    ],
)
def test_two_frames_must_meet_each_others_predictions(
    own: float, other: float, shown: dict[int, int]
) -> None:
    assert judged({(3, 3): own, (9, 9): own, (3, 9): other, (9, 3): other}) == shown


@pytest.mark.parametrize(
    ("own", "other", "shown"),
    [
        (0.0, -0.9, {3: 9}),
        (0.0, -0.7, {}),
        (0.5, -0.4, {}),
    ],
)
def test_one_frame_must_meet_another_prediction_better(
    own: float, other: float, shown: dict[int, int]
) -> None:
    assert judged({(3, 3): own, (3, 9): other}) == shown


def test_most_frames_must_meet_their_predictions() -> None:
    fitting = {(3, 3): 0.0, (3, 9): -0.9}
    others = {(k, k): -0.1 for k in range(24) if k != 3}
    assert judged(fitting | others) == {}


def test_no_more_than_a_sixth_of_the_frames_are_suspected() -> None:
    # Five frames in turn show another pattern; the four of the largest gains are suspected.
    pairs: dict[tuple[int, int], float] = {}
    for k in range(5):
        pairs |= {(k, k): 0.0, (k, 10 + k): -1.0 - 0.1 * k}
    assert judged(pairs) == {1: 11, 2: 12, 3: 13, 4: 14}
