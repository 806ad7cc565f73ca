"""Frames out of order and missing frames are named; good captures, of any kind, are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.check.all_checks import check_capture, check_counts, missing_places
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.simulation.simulate import simulate
from tests.check.test_inverse_pairs import gray_code
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
    for finding in check_capture(taken):
        if finding.kind == "order":
            raise InputError(finding.message)


def swapped(count: int, a: int, b: int) -> NDArray[np.int64]:
    order = np.arange(count)
    order[[a, b]] = b, a
    return order


@pytest.mark.parametrize("exposure", [0.3, 2.0])
@pytest.mark.parametrize("count", [8, 32, 64])
def test_good_captures_pass(count: int, exposure: float) -> None:
    for seed, density in enumerate((0.5, 0.1)):
        patterns = BernoulliPatterns(PROJECTOR, count, density, seed)
        follow(capture(patterns, exposure=exposure, seed=seed, noise=0.02))


@pytest.mark.parametrize(
    "patterns",
    [
        HadamardPatterns(PROJECTOR, 48, "random", True),
        HadamardPatterns(PROJECTOR, 64, "sequency"),
        gray_code(),
        BlockPatterns(PROJECTOR, (2, 2)),
        ImagePatterns(np.repeat(gray_code().stack, 2, axis=0)),
    ],
    ids=["hadamard", "sequency", "gray code", "blocks", "each pattern twice"],
)
def test_good_captures_of_other_patterns_pass(patterns: PatternSet) -> None:
    follow(capture(patterns, exposure=1.5, noise=0.02))


@pytest.mark.parametrize(
    ("scene", "order", "count"), [("l_objects", "random", 64), ("corner", "natural", 256)]
)
def test_part_of_the_hadamard_patterns_is_in_order(scene: str, order: str, count: int) -> None:
    """They are far more alike in places, and less so as a whole, than random patterns."""
    patterns = make_patterns("hadamard", (64, 64), count=count, order=order)
    taken = simulate(scene, patterns, exposure=0.3, noise=0.001)
    assert {each.kind for each in check_capture(taken)} <= {"patterns"}
    frames = np.stack([taken.frames.read(k) for k in swapped(count, 10, 40)])
    found = check_capture(Capture.from_arrays(patterns, frames, taken.decoder))
    assert [each.frames for each in found if each.kind == "frame"] == [(10, 40)]


def test_a_diffuse_scene_is_left_alone() -> None:
    generator = np.random.default_rng(0)
    patterns = BernoulliPatterns(PROJECTOR, 64)
    light = patterns.forward(generator.uniform(0, 2 / 320, (400, 320)))
    sensor = Sensor(read_noise=0.01)
    frames = sensor.expose(light).T.reshape(64, 20, 20)
    follow(Capture.from_arrays(patterns, frames[swapped(64, 3, 9)], sensor))


@pytest.mark.parametrize(("count", "exposure", "seed"), [(20, 1.5, 0), (32, 0.3, 1), (64, 1.5, 0)])
def test_two_swapped_frames_are_named(count: int, exposure: float, seed: int) -> None:
    a, b = np.sort(np.random.default_rng(seed).permutation(count)[:2])
    patterns = BernoulliPatterns(PROJECTOR, count, seed=seed)
    mixed = capture(patterns, swapped(count, a, b), exposure=exposure, seed=seed)
    with pytest.raises(InputError, match=f"frame {a} and frame {b} look swapped"):
        follow(mixed)
    refuse_unusable(mixed)


@pytest.mark.parametrize("first", [5, 55])
def test_a_missing_frame_shifts_those_after_it(first: int) -> None:
    patterns = BernoulliPatterns(PROJECTOR, 64)
    order = np.append(np.delete(np.arange(64), first), 63)
    with pytest.raises(InputError, match="after its own") as caught:
        follow(capture(patterns, order))
    if first > 32:
        assert f"from frame {first} to frame 6" in caught.value.message


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (np.roll(np.arange(48), -1), "each photograph shows the pattern after its own"),
        (np.roll(np.arange(48), 1), "each photograph shows the pattern before its own"),
        (np.insert(np.delete(np.arange(48), 30), 30, 29), "frame 30 shows the pattern of frame 29"),
    ],
)
def test_displaced_and_repeated_frames(order: NDArray[np.int64], words: str) -> None:
    with pytest.raises(InputError, match=words):
        follow(capture(BernoulliPatterns(PROJECTOR, 48), order))


def lost(count: int, place: int) -> NDArray[np.int64]:
    """The frames when one is missing and the last is there twice."""
    return np.append(np.delete(np.arange(count), place), count - 1)


@pytest.mark.parametrize(
    ("renamed", "order", "words"),
    [
        (True, np.arange(48), None),
        (True, lost(48, 22), "from frame 2[123] to .* after its own"),
        (True, np.append(0, np.arange(47)), "each photograph shows the pattern before its own"),
        (False, lost(48, 22), "from frame 2[123] to .* after its own"),
        (False, np.append(np.arange(1, 48), 47), "each photograph shows the pattern after its own"),
    ],
)
def test_displaced_frames_of_several_exposures_are_noticed(
    renamed: bool, order: NDArray[np.int64], words: str | None
) -> None:
    """Their exposure goes with them where files were renamed, else it is that of their place."""
    exposure = np.tile([2.0, 0.5, 2.0, 0.125], 12)
    patterns = BernoulliPatterns(PROJECTOR, 48)
    light = np.ascontiguousarray(patterns.forward(surface())[:, order])
    sensor = Sensor(exposure[order] if renamed else exposure, read_noise=0.003)
    found = Capture.from_arrays(
        patterns, sensor.expose(light).T.reshape(48, *CAMERA), Sensor(exposure)
    )
    with nullcontext() if words is None else pytest.raises(InputError, match=words):
        follow(found)


def test_a_capture_is_judged_as_check_does() -> None:
    patterns = BernoulliPatterns(PROJECTOR, 64)
    mixed = capture(patterns, swapped(64, 4, 9))
    found = [finding for finding in lm.check(mixed) if finding.kind == "order"]
    with pytest.raises(InputError) as refused:
        refuse_unordered(mixed)
    assert refused.value.message == found[0].message


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
    for left, named in ((23, ()), (80, (13,))):
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
    assert (found.kind, found.frames) == ("counts", (3,))
    assert found.message == (
        "9 patterns, but 8 photographs; their names leave out number 4: that of pattern 3 (counted "
        "from 0) is missing, before IMG_0005.png"
    )
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
        "that of pattern 13 (counted from 0) is missing, before IMG_0113.png"
    )
    last = check_counts(survey(31), 32, names)
    assert last.message.endswith("that of pattern 31 (counted from 0) is missing")
    # The gap in the names comes first.
    gap = check_counts(survey(13), 32, images(*range(4), *range(5, 32)))
    assert gap.frames == (4, 13)
    assert "leave out number 4: that of pattern 4 or 13 (counted from 0) is missing" in gap.message
    one = check_counts(survey(13), 32, images(*range(13), *range(14, 32)))
    assert one.frames == (13,)
    # Names that give the time, in text order, take no memory.
    assert check_counts(survey(13), 32, images(*range(0, 31 * 10**18, 10**18))).frames == (13,)
    # Two are missing: the survey is of no use.
    assert check_counts(survey(13), 32 + 1, names).frames == ()


def test_stripes_too_fine_to_be_seen_have_no_order() -> None:
    capture = draw("broad", "stripes", "intact", 32, 0).capture
    assert [each.kind for each in check_capture(capture)] == ["stripes"]
    # Stripes that show are in order, or said not to be.
    frames = [capture.frame(k) for k in range(capture.count)]
    frames[8], frames[13] = frames[13], frames[8]
    swapped = lm.Capture.from_arrays(capture.patterns, np.stack(frames), capture.decoder)
    assert [each.frames for each in check_capture(swapped) if each.kind == "order"] == [(8, 13)]


def test_scrambled_fibres_have_no_neighbours_but_follow_stripes_and_their_inverses() -> None:
    capture = draw("permutation", "stripes", "intact", 16, 5089).capture
    assert not {"order", "unrelated"} & {each.kind for each in check_capture(capture)}
