"""Faults that unseen photographs do not show: no error of T is stated, and the reason is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks import synthetic_captures
from benchmarks.synthetic_captures import draw
from lightmatrix.evaluation.doubts import OwnError
from lightmatrix.evaluation.metrics import relative_error


@pytest.mark.parametrize(
    ("scene", "patterns", "damage", "reason"),
    [
        ("gripper", "few", "leak", "does not follow the patterns"),
        ("metal", "hadamard", "pedestal", "does not follow the patterns"),
        ("metal", "random", "curve", "linear in light"),
        ("glints", "shown twice", "intact", "in most photographs"),
        ("fibres", "shown twice", "overexposed", "shorter exposure"),
        ("metal", "with inverses", "overexposed", "shorter exposure"),
    ],
)
def test_no_error_is_stated_where_it_cannot_be_known(
    scene: str, patterns: str, damage: str, reason: str
) -> None:
    case = draw(scene, patterns, damage, 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    error = OwnError(estimate).estimated
    assert error is not None
    assert relative_error(estimate, case.truth) > max(0.05, 1.2 * error)
    assert OwnError(estimate).stated is None
    verdict = lm.verdict(estimate)
    assert verdict.level == "doubtful"
    assert reason in verdict.sentence


@pytest.mark.parametrize(
    ("scene", "patterns"),
    [
        ("gripper", "random"),
        ("l_objects", "few"),
        ("corner", "few"),
        ("metal", "random"),
        ("textured", "hadamard"),
        ("half lit", "shown twice"),
    ],
)
def test_intact_captures_state_about_the_true_error(scene: str, patterns: str) -> None:
    case = draw(scene, patterns, "intact", 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    assert OwnError(estimate).doubts == []
    stated, true = OwnError(estimate).stated, relative_error(estimate, case.truth)
    assert stated is not None
    assert true / 2 < stated < 2 * true
    assert lm.verdict(estimate).level in ("good", "fair")


@pytest.mark.parametrize(
    ("scene", "patterns", "damage"),
    [
        # All patterns show a pixel and its twin in the other half alike.
        ("wall", "tiled", "intact"),
        # The right half of the projector is never lit.
        ("wall", "half dark", "intact"),
        # Two glints hold most of the light, and clip.
        ("glints", "random", "intact"),
        ("wall", "random", "overexposed"),
        ("gripper", "random", "overexposed"),
        ("wall", "random", "leak"),
        # Each camera pixel sees a line of the projector, and most samples clip.
        ("columns", "few", "overexposed"),
    ],
)
def test_a_wrong_estimate_is_doubtful(
    scene: str, patterns: str, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(synthetic_captures.PATTERNS, "half dark", _half_dark)
    case = draw(scene, patterns, damage, 16, 5)
    kinds = {finding.kind for finding in lm.check(case.capture)}
    estimate = lm.estimate(case.capture, check=False)
    assert relative_error(estimate, case.truth) > 0.25
    assert lm.verdict(estimate).with_findings(kinds).level == "doubtful"


def _half_dark(size: int, generator: np.random.Generator) -> synthetic_captures.Floats:
    images = generator.integers(0, 2, (64, size, size)).astype(np.float32)
    images[:, :, size // 2 :] = 0
    return images


def test_pixels_one_by_one_are_not_tested() -> None:
    case = draw("wall", "one pixel", "intact", 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    assert relative_error(estimate, case.truth) < 0.05
    assert lm.verdict(estimate).level == "not tested"


def test_rows_that_are_only_bounded_raise_the_stated_error() -> None:
    case = draw("gripper", "few", "intact", 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    before = OwnError(estimate).stated
    light = np.asarray(estimate.sparse.sum(axis=1)).ravel()
    bounded = light > np.quantile(light, 0.9)
    changed = replace(estimate, diagnostics={**estimate.diagnostics, "only_bounded": bounded * 1.0})
    after = OwnError(changed).stated
    assert before is not None
    assert after is not None
    assert after > 2 * before
