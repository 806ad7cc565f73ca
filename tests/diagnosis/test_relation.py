"""Captures whose photographs do not follow their patterns, and intact ones that look odd."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.synthetic_captures import PATTERNS, SCENES, draw
from lightmatrix.diagnosis.all_checks import check_capture
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.relation import (
    _TURNS,
    Relation,
    _orders,
    _products,
    _triples,
    check_relation,
)
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.errors import InputError, LightMatrixWarning


def relation(capture: lm.Capture) -> list[Finding]:
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    return check_relation(survey, [f"frame {k}" for k in range(survey.count)])


@pytest.mark.parametrize("scene", ["textured", "translucent", "permutation"])
@pytest.mark.parametrize(
    ("damage", "kind", "words"),
    [
        ("other seed", "unrelated", "do not follow the patterns"),
        ("random order", "unrelated", "do not follow the patterns"),
        ("by name", "order", "photographs are in the order of their names"),
        ("patterns inverted", "order", "negative"),
        ("negative", "order", "negative"),
        ("half turned", "order", "from about frame 32 on, the photographs are turned by 180"),
        ("half mirrored", "order", "from about frame 32 on, the photographs are mirrored left"),
        ("half turned by 90", "order", "turned by 270 degrees"),
        ("rows late", "order", "every other row of the photographs comes a frame late"),
    ],
)
def test_names_what_the_photographs_follow(scene: str, damage: str, kind: str, words: str) -> None:
    (finding,) = check_capture(draw(scene, "random", damage, 16, 3).capture)
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


def test_noise_alone_is_no_relation_to_judge() -> None:
    frames = np.random.default_rng(0).integers(90, 110, (32, 16, 16)).astype(np.uint8)
    assert (
        relation(lm.Capture.from_arrays(lm.BernoulliPatterns((16, 16), 32), frames, lm.Sensor()))
        == []
    )


def test_estimate_refuses_what_is_explained_and_warns_of_the_rest() -> None:
    with pytest.raises(InputError, match="order of their names") as refused:
        lm.estimate(draw("textured", "random", "by name", 16, 0).capture)
    assert "--no-check" in (refused.value.hint or "")
    capture = draw("textured", "random", "other seed", 16, 0).capture
    with pytest.warns(LightMatrixWarning, match=re.escape("do not follow the patterns")):
        lm.estimate(capture, coherent=False, iterations=2)


# ---- the parts


def made(scene: str = "textured", damage: str = "intact", seed: int = 1) -> Relation:
    capture = draw(scene, "random", damage, 16, seed).capture
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    result = Relation.of(survey)
    assert result is not None
    return result


def test_few_frames_are_not_judged() -> None:
    capture = draw("textured", "random", "other seed", 16, 0).capture
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    names = [f"frame {k}" for k in range(survey.count)]
    for count, kinds in ((15, []), (40, ["unrelated"])):
        few = replace(
            survey.select_frames(np.arange(count)),
            patterns=capture.patterns.subset(np.arange(count)),
        )
        assert [each.kind for each in check_relation(few, names)] == kinds


def test_only_the_right_order_exceeds_chance() -> None:
    relation = made()
    frames = np.arange(len(relation.frames))
    assert relation.as_they_are == relation.excess(relation.cosines, frames)
    assert relation.as_they_are > 20
    assert relation._settled > 20
    assert not relation.unrelated
    generator = np.random.default_rng(9)
    for _ in range(5):
        assert abs(relation.excess(relation.cosines, generator.permutation(frames))) < 4
    # Frames beyond the last pattern show none; the others still follow.
    assert relation.excess(relation.cosines, frames + 1) < 4
    mean, deviation = relation._chance
    more = len(frames) / (len(frames) - 1)
    for step, known in ((-1, frames[1:]), (1, frames[:-1])):
        matched = relation._match(relation.cosines, known, known + step)
        expected = (matched - mean * more) / (deviation * more)
        assert relation.excess(relation.cosines, frames + step) == pytest.approx(expected)
    shifted = relation.cosines[1:][:, 1:]
    again = np.zeros_like(relation.cosines)
    again[:-1, :-1] = shifted
    assert relation.excess(again, frames + 1) > 15
    assert relation.excess(relation.cosines, frames + len(frames) - 14) == 0


def test_chance_is_that_of_shuffled_frames() -> None:
    relation = made()
    mean, deviation = relation._chance
    generator = np.random.default_rng(5)
    drawn = [
        relation._match(relation.cosines, relation.frames, generator.permutation(relation.frames))
        for _ in range(200)
    ]
    assert abs(mean - np.mean(drawn)) < 0.5 * np.std(drawn)
    assert 0.7 < deviation / np.std(drawn) < 1.4


def test_halves_of_the_camera_agree_unless_all_is_noise() -> None:
    relation = made()
    assert relation._agreement > 0.3
    # Many pixels see one of four places each.
    alike = np.repeat(relation.images[:2, :2], 64, axis=0)
    assert replace(relation, images=alike)._agreement > 0.95
    noise = np.random.default_rng(0).standard_normal(relation.images.shape).astype(np.float32)
    assert abs(replace(relation, images=noise)._agreement) < 0.3


def test_little_evidence_accuses_nobody() -> None:
    relation = made(damage="other seed", seed=0)
    assert relation.unrelated
    assert not replace(relation, pixels=relation.pixels * 40).unrelated
    noise = np.random.default_rng(0).standard_normal(relation.images.shape).astype(np.float32)
    assert not replace(relation, images=noise, lively=False).unrelated
    alike = 1e-4 * relation.features
    assert not replace(relation, features=alike).unrelated


def test_parts_of_frames_are_not_turned() -> None:
    turned = made(damage="half turned")
    names = [f"frame {k}" for k in range(len(turned.frames))]
    explained = turned.explanation(names)
    assert explained is not None
    assert "turned by 180 degrees" in explained[0]
    assert replace(turned, whole=False).explanation(names) is None
    late = made(damage="rows late")
    assert late._late() is not None
    assert replace(late, whole=False)._late() is None


@pytest.mark.parametrize("what", sorted(_TURNS))
def test_every_turn_is_named(what: str) -> None:
    relation = made()
    inverse = {"turned by 90 degrees": "turned by 270 degrees"}
    inverse |= {there: here for here, there in inverse.items()}
    turned = relation.images.copy()
    turned[..., 32:] = _TURNS[inverse.get(what, what)](relation.images[..., 32:])
    explained = replace(relation, images=turned).explanation([f"frame {k}" for k in range(64)])
    assert explained is not None
    assert explained[0] == f"from about frame 32 on, the photographs are {what}"
    assert "turn them back" in explained[1]


def test_triples_are_of_different_frames() -> None:
    triples = _triples(12)
    assert (triples[:, 0] < triples[:, 1]).all()
    assert (triples[:, 1] < triples[:, 2]).all()
    assert len(np.unique(triples, axis=0)) == len(triples)
    # Nearly all of the 220; of many frames as many as are wanted.
    assert len(triples) > 215
    assert triples.min() == 0
    assert triples.max() == 11
    many = _triples(100)
    assert len(many) == 4000
    assert many.max() == 99
    assert abs(many[:, 1].mean() - 49.5) < 2


def test_products_of_three_frames() -> None:
    rows = np.random.default_rng(0).standard_normal((600, 20)).astype(np.float32)
    triples = _triples(20)
    a, b, c = triples.T
    expected = (rows[:, a] * rows[:, b] * rows[:, c]).sum(axis=0)
    np.testing.assert_allclose(_products(rows, triples), expected, rtol=1e-3, atol=1e-3)


def test_orders_that_frames_come_in_by_mistake() -> None:
    orders = dict(_orders(12))
    assert len(orders) == 7
    for first in (0, 1):
        names = [str(k + first) for k in range(12)]
        by_name = [int(name) - first for name in sorted(names)]
        text = f"({first}, {'10, 11' if first else '1, 10'}, ...)"
        start = "the photographs are in the order of their names as text " + text
        assert orders[start + ", and the patterns by their numbers"].tolist() == by_name
        start = "the patterns are in the order of their names as text " + text
        shown = orders[start + ", and the photographs by their numbers"]
        assert [by_name[k] for k in shown] == list(range(12))
    assert orders["each photograph shows the pattern after its own"].tolist() == [*range(1, 13)]
    assert orders["each photograph shows the pattern before its own"].tolist() == [*range(-1, 11)]
    assert orders["the photographs follow the patterns backwards"].tolist() == [*range(11, -1, -1)]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (np.arange(63, -1, -1), "the photographs follow the patterns backwards"),
        (np.roll(np.arange(64), -1), "each photograph shows the pattern after its own"),
        (np.roll(np.arange(64), 1), "each photograph shows the pattern before its own"),
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
