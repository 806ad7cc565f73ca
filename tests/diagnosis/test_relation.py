"""Captures whose photographs do not follow their patterns, and intact ones that look odd."""

import re

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.synthetic_captures import PATTERNS, SCENES, draw
from lightmatrix.diagnosis.all_checks import check_capture
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.relation import check_relation
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.errors import InputError, LightMatrixWarning


def relation(capture: lm.Capture) -> list[Finding]:
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    return check_relation(survey, [f"frame {k}" for k in range(survey.count)])


@pytest.mark.parametrize("scene", ["textured", "translucent"])
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
