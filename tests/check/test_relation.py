"""Captures whose photographs do not follow their patterns, and intact ones that look odd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.synthetic_captures import PATTERNS, SCENES, draw, scene_matrix
from lightmatrix.check.all_checks import check_capture
from lightmatrix.check.finding import Finding
from lightmatrix.check.relation import Relation, check_relation, check_unseen
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError


def relation(capture: lm.Capture) -> list[Finding]:
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    return check_relation(survey)


@pytest.mark.parametrize(
    ("scene", "damage", "kind", "words"),
    [
        ("textured", "other seed", "unrelated", "do not follow the patterns"),
        ("permutation", "other seed", "unrelated", "do not follow the patterns"),
        ("translucent", "random order", "unrelated", "do not follow the patterns"),
        ("textured", "by name", "order", "photographs are in the order of their names"),
        ("translucent", "patterns inverted", "order", "negative"),
        ("permutation", "negative", "order", "negative"),
        ("textured", "half turned", "motion", "turned or moved"),
        ("permutation", "half turned", "motion", "turned or moved"),
        ("translucent", "half turned by 90", "motion", "turned or moved"),
    ],
)
def test_names_what_the_photographs_follow(scene: str, damage: str, kind: str, words: str) -> None:
    # All checks together take seconds where light is smooth.
    look = check_capture if scene == "permutation" or kind == "order" else relation
    (finding,) = look(draw(scene, "random", damage, 16, 3).capture)
    assert finding.kind == kind
    assert words in finding.message


@pytest.mark.parametrize("patterns", sorted(PATTERNS))
@pytest.mark.parametrize("scene", sorted(SCENES))
def test_accuses_no_intact_capture(scene: str, patterns: str) -> None:
    assert relation(draw(scene, patterns, "intact", 16, 1).capture) == []


@pytest.mark.parametrize("scene", ["textured", "diffuse", "broad"])
@pytest.mark.parametrize("patterns", ["random", "few", "with inverses"])
def test_accuses_no_crop(scene: str, patterns: str) -> None:
    capture = draw(scene, patterns, "intact", 32, 2).capture
    for corner in ((0, 0), (12, 9)):
        assert relation(capture.crop(corner, (12, 12))) == []


def test_halves_that_light_different_places_are_not_compared() -> None:
    """Single pixels of the projector row by row, whose camera pixels see few of them each."""
    scene = np.eye(256) + 0.3 * np.eye(256, k=1) + 0.2 * np.eye(256, k=16) + 0.001
    patterns = lm.BlockPatterns((16, 16), (1, 1))
    frames = np.rint(200 * scene.T / scene.max()).astype(np.uint8).reshape(256, 16, 16)
    assert relation(lm.Capture.from_arrays(patterns, frames, lm.Decoder(255, 255))) == []


def test_noise_alone_is_no_relation_to_judge() -> None:
    frames = np.random.default_rng(0).integers(90, 110, (32, 16, 16)).astype(np.uint8)
    assert (
        relation(lm.Capture.from_arrays(lm.BernoulliPatterns((16, 16), 32), frames, lm.Sensor()))
        == []
    )


def test_estimate_refuses_photographs_of_other_patterns() -> None:
    with pytest.raises(InputError, match="do not follow the patterns") as refused:
        lm.estimate(draw("textured", "few", "other seed", 16, 0).capture)
    assert "check=False" in (refused.value.hint or "")


@pytest.mark.parametrize(
    ("scene", "seed"),
    [("translucent", 1), pytest.param("wall", 0, marks=pytest.mark.slow)],
)
def test_a_camera_that_sees_a_part_of_the_projector_is_not_accused(scene: str, seed: int) -> None:
    """Under 16 patterns, where little tells what photographs follow."""
    size, generator = 32, np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 2, indexing="ij"), -1).reshape(-1, 2)
    places = generator.uniform(0, 0.7 * size, 2) + 0.3 * grid
    spread = {"wall": 0.6, "translucent": 1.5}[scene]
    away = ((places[:, None] - grid) ** 2).sum(axis=2)
    matrix = np.exp(-away / (2 * spread**2)) / spread**2
    patterns = lm.BernoulliPatterns((size, size), 16, seed=seed)
    light = matrix @ patterns.rows(0, 16).T
    raw = lm.Sensor(1.0, 0.0, 0.003).expose(light / light.max(), seed=seed)
    frames = np.ascontiguousarray(raw.T).reshape(16, size, size)
    for seen, kinds in ((patterns, []), (replace(patterns, seed=seed + 100), ["unrelated"])):
        found = relation(lm.Capture.from_arrays(seen, frames, lm.Sensor(1.0, 0.0, 0.003)))
        assert [each.kind for each in found] == kinds


@pytest.mark.parametrize("ground", [0.0, 0.02, 0.04])
def test_a_dark_ground_around_bright_dots_sees_the_projector(ground: float) -> None:
    """Its noise is no dark photograph of white, and no light that changes either."""
    size, generator = (32, 32), np.random.default_rng(1)
    codes = lm.make_patterns("graycode", size, inverse=True)
    albedo = np.where(generator.random(1024) < 0.07, 1, ground)[:, None]
    for patterns, scene, noise in (
        (lm.BernoulliPatterns(size, 32, seed=1), "own pixels", 0.003),
        (codes, "broad", 0.01),
    ):
        matrix = scene_matrix(scene, 32, generator) * albedo
        light = matrix @ patterns.rows(0, patterns.count).T
        sensor = lm.Sensor(0.9 / light.max(), 0.0, noise)
        frames = sensor.expose(light.astype(np.float32), seed=1).T.reshape(-1, *size)
        capture = lm.Capture.from_arrays(patterns, np.ascontiguousarray(frames), sensor)
        found, seeing = check_unseen(Survey.take(patterns, capture.frames, capture.decoder))
        assert [each.kind for each in found] == ([] if ground else ["unseen"])
        assert (seeing.valid.mean() < 0.1) == (ground == 0)
    assert {each.kind for each in check_capture(capture)} - {"unseen"} == {"stripes"}


# ---- the parts


def made(scene: str = "textured", damage: str = "intact", seed: int = 1) -> Relation:
    capture = draw(scene, "random", damage, 16, seed).capture
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    result = Relation.of(survey)
    assert result is not None
    return result


def test_few_frames_are_not_judged() -> None:
    capture = draw("textured", "random", "other seed", 16, 1).capture
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    for count, kinds in ((15, []), (40, ["unrelated"])):
        few = replace(
            survey.select_frames(np.arange(count)),
            patterns=capture.patterns.subset(np.arange(count)),
        )
        assert [each.kind for each in check_relation(few)] == kinds


@pytest.mark.parametrize(("camera", "judged"), [(24, False), (47, True)])
def test_sharp_pixels_of_large_projectors_are_not_accused(camera: int, judged: bool) -> None:
    """Pixels that see one of many projector pixels follow the patterns, but not their bins."""
    size = (257, 256)
    patterns = lm.BernoulliPatterns(size, 64, seed=2)
    places = np.random.default_rng(0).permutation(patterns.pixels)[: camera**2]
    frames = (200 * patterns.columns(places)).astype(np.uint8).reshape(64, camera, camera)

    def relation(shown: lm.PatternSet, frames: NDArray[np.uint8]) -> Relation:
        capture = lm.Capture.from_arrays(shown, frames, lm.Sensor())
        made = Relation.of(Survey.take(shown, capture.frames, capture.decoder))
        assert made is not None
        return made

    other = relation(lm.BernoulliPatterns(size, 64, seed=9), frames)
    assert not relation(patterns, frames).unrelated
    assert other.unrelated == judged
    if judged:
        assert relation(patterns, frames).as_they_are > 3.5 > other.as_they_are
        # A frame that is lost moves all that follow.
        lost = relation(patterns, np.concatenate([frames[:30], frames[31:], frames[:1]]))
        excess, *found = lost.displaced()
        assert found == [30, 1]
        assert excess > lost.as_they_are


def test_little_evidence_accuses_nobody() -> None:
    relation = made(damage="other seed", seed=0)
    assert relation.unrelated
    assert not replace(relation, samples=relation.samples[::40]).unrelated
    noise = np.random.default_rng(0).standard_normal(relation.samples.shape).astype(np.float32)
    assert not replace(relation, samples=noise, contrasted=False).unrelated
    alike = 1e-4 * relation.features
    assert not replace(relation, features=alike).unrelated


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (np.roll(np.arange(64), -1), "each photograph shows the pattern after its own"),
        (np.roll(np.arange(64), 1), "each photograph shows the pattern before its own"),
        (np.arange(64)[::-1], "the photographs are in the opposite order"),
        (np.roll(np.arange(64), -10), "begin with that of pattern 10"),
        (np.roll(np.arange(64), 2), "begin with that of pattern 62"),
        (np.argsort(sorted(range(64), key=str)), "the patterns are in the order of their names"),
    ],
)
def test_other_orders_are_recognised(order: NDArray[np.int64], words: str) -> None:
    capture = draw("textured", "random", "intact", 16, 3).capture
    frames = np.stack([capture.frame(int(k)) for k in order])
    mixed = lm.Capture.from_arrays(capture.patterns, frames, lm.Sensor(1.0, 0.0, 0.003))
    (finding,) = relation(mixed)
    assert words in finding.message
    assert "same order" in finding.advice


def test_a_curve_under_two_exposures_is_no_other_series() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32, seed=1)
    capture = lm.simulate(
        "metal",
        patterns,
        exposure="0.587:0.75,0.146:0.25",
        noise=0.003,
        faults={"camera-curve": 2.2},
    )
    assert "unrelated" not in [each.kind for each in check_capture(capture)]


def test_few_frames_of_two_exposures_follow_their_patterns() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 16, seed=1)
    capture = lm.simulate("metal", patterns, exposure="0.587:0.5,0.146:0.5")
    other = replace(capture, patterns=replace(patterns, seed=2))
    assert relation(capture) == []
    assert [each.kind for each in relation(other)] == ["unrelated"]


@pytest.mark.parametrize(
    ("scene", "fault", "amount"),
    [
        ("l_objects", "shake", 0.3),
        ("metal", "creep", 1.0),
        ("metal", "previous", 0.15),
    ],
)
def test_what_a_rig_does_to_all_camera_pixels_hides_no_relation(
    scene: str, fault: str, amount: float
) -> None:
    """A camera that moves, or a bit of the picture before, under 16 patterns."""
    patterns = lm.BernoulliPatterns((64, 64), 16, seed=1)
    exposure = "0.587:0.5,0.146:0.5" if scene == "metal" else 0.445
    capture = lm.simulate(scene, patterns, exposure=exposure, noise=0.003, faults={fault: amount})
    other = replace(capture, patterns=replace(patterns, seed=21))
    assert relation(capture) == []
    assert [each.kind for each in relation(other)] == ["unrelated"]


@pytest.mark.parametrize("exposure", ["2.3:0.34,0.575:0.33,0.143:0.33", "4:0.5,0.3:0.5"])
def test_sixteen_frames_that_partly_clip_are_no_other_series(exposure: str) -> None:
    """A few frames of each exposure, or those that clip all over, tell too little by themselves."""
    patterns = lm.BernoulliPatterns((64, 64), 16)
    for scene in ("corner", "l_objects"):
        assert relation(lm.simulate(scene, patterns, exposure=exposure, noise=0.01)) == []


def test_patterns_of_any_density_under_two_exposures_are_no_other_series() -> None:
    """Such photographs are divided by their mean brightness, and so must their patterns be."""
    generator = np.random.default_rng(1)
    shares = generator.uniform(0.2, 0.8, (2, 16, 1, 1))
    images = (generator.random((2, 16, 64, 64)) < shares).astype(np.float32)
    shown, others = (lm.ImagePatterns(each) for each in images)
    capture = lm.simulate("metal", shown, exposure="0.587:0.5,0.146:0.5", noise=0.003)
    assert relation(capture) == []
    assert [each.kind for each in relation(replace(capture, patterns=others))] == ["unrelated"]
