"""Frames out of order and missing frames are named; good captures, of any kind, are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.check import all_checks
from lightmatrix.check.finding import order_findings
from lightmatrix.check.frame_order import (
    Hypothesis,
    RawRows,
    check_counts,
    check_order,
    find_misses,
    likeliest_hypothesis,
    missing_places,
    scores_by_place,
)
from lightmatrix.check.pursuit import column_scale
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import one_pixel_patterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from tests.helpers.surface import CAMERA, PROJECTOR, photographs, surface


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
    survey = Survey.take(taken.patterns, taken.frames, taken.decoder)
    for finding in check_order(survey, taken.frames.name):
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
    monkeypatch.setattr(all_checks, "check_order", lambda *_: suspected)
    taken = capture(patterns)
    assert lm.check(taken) == []
    refuse_unordered(taken)


K = 48


PATTERNS = BernoulliPatterns(PROJECTOR, K)


FRAMES = np.arange(K)


def rows(
    order: NDArray[np.integer] = FRAMES,
    exposure: NDArray[np.floating] | None = None,
    exposed_as: NDArray[np.integer] = FRAMES,
) -> RawRows:
    """Every fourth row of the surface, whose frames show `order`, exposed like `exposed_as`."""
    exposure = np.ones(K) if exposure is None else exposure
    light = PATTERNS.forward(surface())[::4][:, order]
    level = np.broadcast_to(3 / exposure, light.shape).astype(np.float32)
    shares = np.minimum(light * exposure[exposed_as] / 3, 1)
    return RawRows(shares.astype(np.float32), level)


def displaced(step: int, first: int, last: int) -> NDArray[np.int64]:
    order = FRAMES.copy()
    order[first:last] += step
    return order.clip(0, K - 1)


def test_samples_read_at_another_exposure() -> None:
    shares = np.array([[0.5, 1.0, 0.25]], np.float32)
    raw = RawRows(shares, np.array([[1.0, 2.0, 4.0]], np.float32))
    assert raw.lowest.tolist() == [[1.0]]
    np.testing.assert_allclose(raw.light(np.arange(3)), [[0.5, 1, 1]])
    np.testing.assert_allclose(raw.light(np.array([1, 0, 0])), [[1, 1, 0.25]])
    assert [group.tolist() for group in raw.exposure_groups()] == [[0], [1], [2]]
    equal = RawRows(shares, np.array([[1.0, 2.0, 1.001]], np.float32))
    assert [group.tolist() for group in equal.exposure_groups()] == [[0, 2], [1]]


@pytest.mark.parametrize(
    "order",
    [
        displaced(1, 24, K),
        displaced(1, 0, 12),
        displaced(-1, 36, K),
        displaced(-1, 0, 24),
        displaced(1, 0, K),
    ],
    ids=["after", "after, up to one", "before", "before, up to one", "all"],
)
def test_the_likeliest_hypothesis_is_the_true_one(order: NDArray[np.int64]) -> None:
    best = likeliest_hypothesis(PATTERNS, rows(order))
    assert best is not None
    known = best.order >= 0
    assert (best.order == order)[known].mean() > 0.97
    assert known.sum() >= K - 1
    np.testing.assert_array_equal(best.exposed_as, FRAMES)


@pytest.mark.parametrize("renamed", [True, False])
def test_exposures_go_with_the_files_or_stay(renamed: bool) -> None:
    exposure = np.tile([4.0, 1.0, 4.0, 0.5], K // 4)
    order = displaced(1, 0, K)
    best = likeliest_hypothesis(PATTERNS, rows(order, exposure, order if renamed else FRAMES))
    assert best is not None
    np.testing.assert_array_equal(best.order[:-1], order[:-1])
    assert (best.exposed_as[:-1] == (order if renamed else FRAMES)[:-1]).all()


def test_misses_are_those_of_the_other_pattern() -> None:
    scale = column_scale(PATTERNS)
    order = FRAMES.copy()
    order[[4, 9]] = 9, 4
    misses = find_misses(PATTERNS, rows(order), Hypothesis.in_order(K), scale)
    assert misses.logarithms.shape == (K, K)
    assert misses.logarithms[4].argmin() == 9
    assert misses.logarithms[9].argmin() == 4
    usual = np.delete(misses.own, [4, 9])
    assert np.median(usual) < -1
    assert misses.own[[4, 9]].min() > 0
    assert misses.informative.all()
    assert not misses.elsewhere.any()
    # As it is, once it is known which frame shows which pattern; or that one is unknown.
    right = find_misses(PATTERNS, rows(order), Hypothesis(order, FRAMES), scale)
    assert right.logarithms[FRAMES, order].max() < 0
    unknown = np.where(order == FRAMES, FRAMES, -1)
    without = find_misses(PATTERNS, rows(order), Hypothesis(unknown, FRAMES), scale)
    assert without.logarithms[FRAMES, order].max() < 0


def test_a_frame_taken_with_the_exposure_of_another_is_recognised() -> None:
    exposure = np.where(FRAMES % 4 == 3, 0.5, 1.0)
    order = FRAMES.copy()
    order[[4, 11]] = 11, 4
    misses = find_misses(
        PATTERNS, rows(order, exposure, order), Hypothesis.in_order(K), column_scale(PATTERNS)
    )
    assert misses.elsewhere[4, 11]
    assert not np.diag(misses.elsewhere).any()


def test_places_are_scored_by_the_pixels_that_follow_the_rows() -> None:
    """The scores are those of brute force, and highest at the place of the change."""
    count = 32
    patterns = BernoulliPatterns((4, 5), count, seed=2)
    frames = np.arange(count)
    shown = patterns.columns(np.arange(20)).astype(float)
    shown -= shown.mean(axis=0)
    shown /= np.sqrt((shown**2).sum(axis=0))
    late = np.append(frames[1:], -1)
    # Three rows see one pixel each; from frame 16 on, each frame shows the next pattern.
    order = np.where(frames < 16, frames, late)
    light = (shown[order][:, [3, 9, 17]].T * (order >= 0)).astype(np.float32)
    moved = np.where(late >= 0, light, 0).astype(np.float32)
    cuts = range(0, count + 1, 8)
    scores = scores_by_place(patterns, (light, frames), (moved, late), cuts)
    assert scores[0, 2] == scores.max()
    for until, place in np.ndindex(scores.shape):
        displaced = (frames < cuts[place]) == bool(until)
        mixed = np.where(displaced, moved, light)
        best = np.maximum((mixed @ shown[np.where(displaced, late, frames)]).max(axis=1), 0)
        share = np.minimum(best**2 / np.maximum((mixed**2).sum(axis=1), 1e-12), 0.999)
        assert scores[until, place] == pytest.approx(-np.log1p(-share).mean(), rel=1e-3, abs=1e-4)


DECODER = lm.Decoder(clip=255, full_scale=255)


def survey(place: int, count: int = 32, diffuse: float = 0.3, noise: float = 0.005) -> Survey:
    patterns = BernoulliPatterns(PROJECTOR, count)
    frames = np.delete(photographs(patterns, diffuse=diffuse, noise=noise), place, axis=0)
    capture = lm.Capture.from_arrays(patterns.subset(np.arange(count - 1)), frames, DECODER)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    return replace(taken, patterns=patterns)


@pytest.mark.parametrize("place", [0, 1, 13, 30, 31])
def test_the_missing_frame_is_named(place: int) -> None:
    assert missing_places(survey(place)) == (place,)


def test_nothing_is_named_from_too_little() -> None:
    assert missing_places(survey(5, count=12)) == ()
    few = survey(13)
    lit = np.flatnonzero(few.valid & few.inner)
    for left, named in ((23, ()), (40, (13,))):
        valid = np.zeros_like(few.valid)
        valid[lit[:: len(lit) // left][:left]] = True
        assert missing_places(replace(few, valid=valid)) == named
    noisy = survey(13)
    raw = np.random.default_rng(0).permutation(noisy.raw, axis=1)
    assert missing_places(replace(noisy, raw=raw)) == ()


def images(*numbers: int) -> list[Path]:
    return [Path(f"IMG_{number:04d}.png") for number in numbers]


def test_words_without_a_survey() -> None:
    found = check_counts(None, 9, images(1, 2, 3, 5, 6, 7, 8, 9))
    assert (found.kind, found.frames) == ("counts", ())
    assert found.message == "9 patterns, but 8 photographs; their names leave out number 4"
    assert "take it again" in found.advice
    many = check_counts(None, 40, images(*(k for k in range(40) if k % 5)))
    assert many.message.endswith("leave out number 5, 10, 15, 20, 25")
    assert many.frames == ()
    more = check_counts(None, 3, images(1, 2, 3, 4))
    assert more.message == "3 patterns, but 4 photographs"
    assert "remove what is no photograph" in more.advice


def test_words_with_a_survey() -> None:
    names = images(*range(100, 100 + 32 - 1))
    found = check_counts(survey(13), 32, names)
    assert found.frames == (13,)
    assert found.message.endswith(
        "the one of pattern 13 (the 14th) is missing, before IMG_0113.png"
    )
    last = check_counts(survey(31), 32, names)
    assert last.message.endswith("the one of pattern 31 (the 32nd) is missing")
    # Two are missing: the survey is of no use.
    assert check_counts(survey(13), 32 + 1, names).frames == ()
