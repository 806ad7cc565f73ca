"""The gammas of photographs and grey patterns are measured, and linear ones are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks import frame_checks
from benchmarks.synthetic_captures import draw
from lightmatrix.check.finding import Finding
from lightmatrix.check.linearity import (
    WindowPower,
    check_grey_levels,
    check_linearity,
    power_from_windows,
)
from lightmatrix.check.survey import Survey
from lightmatrix.patterns.bits import BernoulliPatterns
from tests.helpers.surface import PROJECTOR, photographs

K = 32


PATTERNS = BernoulliPatterns(PROJECTOR, K)


def survey(power: float, **options: float) -> Survey:
    """A survey of photographs whose levels are raised to a power."""
    levels = photographs(PATTERNS, noise=0.001, **options) / 255
    frames = np.rint(255 * levels**power).astype(np.uint8)
    capture = lm.Capture.from_arrays(PATTERNS, frames, lm.Decoder(clip=255, full_scale=255))
    return Survey.take(capture.patterns, capture.frames, capture.decoder)


def found(taken: Survey, *, steady: bool = True) -> list[Finding]:
    findings = check_linearity(taken, np.zeros(K, bool), steady=steady)
    assert all(each.kind == "response" and not each.frames for each in findings)
    return findings


def number(finding: Finding) -> tuple[float, float]:
    """The power that a finding states, and its uncertainty."""
    words = finding.message.split()
    return float(words[-3]), float(words[-1])


@pytest.mark.parametrize("gamma", [1.2, 1.8, 2.2, 3.0])
def test_the_gamma_is_measured_with_its_uncertainty(gamma: float) -> None:
    (finding,) = found(survey(1 / gamma))
    measured, uncertainty = number(finding)
    assert measured == pytest.approx(gamma, rel=0.04)
    assert 0 < uncertainty < 0.1 * gamma
    assert 'response="auto"' in finding.advice


@pytest.mark.parametrize("power", [1.5, 1.8, 2.5])
def test_powers_are_measured_in_steady_light_only(power: float) -> None:
    (finding,) = found(survey(power))
    assert number(finding)[0] == pytest.approx(power, rel=0.06)
    assert found(survey(power), steady=False) == []


def test_a_search_that_settles_where_nothing_is_predicted_is_no_finding() -> None:
    """Faint light in much noise, where only the search from another start settles."""
    linear = WindowPower(1.3, 0.01, settled=False, missed=(0.02, 0.02))
    assert not WindowPower(6.0, 0.004, settled=True, missed=(0.3, 0.37)).right_against(linear)
    for missed, right in ((0.0175, True), (0.019, False)):
        found_elsewhere = WindowPower(2.2, 0.004, settled=True, missed=(0.01, missed))
        assert found_elsewhere.right_against(linear) == right
    # Whatever is predicted that well is right, whichever power misses a little less.
    exact = WindowPower(1.0, 0.01, settled=False, missed=(0.0008, 0.0008))
    assert WindowPower(2.2, 0.004, settled=True, missed=(0.01, 0.0013)).right_against(exact)
    for exposure in (0.1, 0.3):
        capture = lm.simulate(
            "corner", BernoulliPatterns((64, 64), K), exposure=exposure, noise=0.003
        )
        taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
        assert found(taken) == []


@pytest.mark.parametrize(
    ("scene", "patterns", "seed"),
    [
        # Light that windows explain badly.
        *(("speckle", "random", seed) for seed in range(3)),
        *(("broad", "few", seed) for seed in range(3)),
        # Light that reaches far.
        ("diffuse", "mixed", 5),
        ("broad", "stripes", 5),
    ],
)
def test_light_that_predictions_miss_is_no_curve(scene: str, patterns: str, seed: int) -> None:
    capture = draw(scene, patterns, "intact", 32, seed).capture
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    assert check_linearity(taken, np.zeros(capture.count, bool), steady=True) == []


def test_linear_photographs_are_left_alone() -> None:
    assert found(survey(1.0)) == []
    assert found(survey(1 / 1.01)) == []
    assert lm.check(grey_capture(1.0, 1.0)) == []


def test_doubted_frames_are_not_learned_from() -> None:
    taken = survey(1.0)
    raw = taken.raw.copy()
    raw[:, :3] = np.random.default_rng(0).integers(0, 200, (len(raw), 3))
    object.__setattr__(taken, "raw", raw)
    assert check_linearity(taken, np.arange(K) < 3, steady=True) == []


def test_few_rows_reveal_nothing() -> None:
    taken = survey(1 / 2.2)
    rows = np.flatnonzero(taken.valid & taken.inner)
    taken.valid[rows[19:]] = False
    assert power_from_windows(taken, np.zeros(K, bool)) is None
    assert found(taken) == []


def test_a_pattern_that_is_shown_again_tells_nothing_new() -> None:
    capture = draw("permutation", "shown four times", "intact", 32, 31011).capture
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    assert (taken.count, taken.distinct_patterns) == (64, 16)
    assert check_linearity(taken, np.zeros(capture.count, bool), steady=True) == []


def test_rows_that_are_predicted_badly_do_not_hide_a_gamma() -> None:
    """32 frames of `l_objects`: an eighth of the rows miss more than a twentieth of their light."""
    scene = list(frame_checks.draws(5, seed=9))[4]
    findings, named = frame_checks.FAULTS["gamma 2.2"](scene, np.random.default_rng(0))
    assert named
    (finding,) = (each for each in findings if each.kind == "response")
    assert number(finding)[0] == pytest.approx(2.2, rel=0.05)


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_rows_of_which_many_samples_clip_are_no_curve(seed: int | None) -> None:
    """32 frames of `corner`, of whose samples 40 % clip or are expected to come close to it."""
    scene = list(frame_checks.draws(8, seed=1009))[7]
    if seed is not None:
        patterns = BernoulliPatterns((64, 64), K, seed=100 + seed)
        scene = replace(scene, patterns=patterns, seed=seed)
    capture = scene.capture(scene.frames())
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    assert found(taken) == []


GREY = np.rint(255 * np.random.default_rng(3).random((K, *PROJECTOR))) / 255


def grey_capture(camera: float, projector: float) -> lm.Capture:
    """Photographs of grey patterns by a camera and a projector of these gammas."""
    light = photographs(lm.ImagePatterns((GREY**projector).astype(np.float32)), noise=0.001) / 255
    frames = np.rint(255 * light ** (1 / camera)).astype(np.uint8)
    decoder = lm.Decoder(clip=255, full_scale=255)
    greys = lm.ImagePatterns(GREY.astype(np.float32))
    return lm.Capture.from_arrays(greys, frames, decoder)


def findings(capture: lm.Capture) -> list[Finding]:
    """What is wrong with the linearity of photographs of grey patterns."""
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    return check_grey_levels(replace(taken, greys=True), np.zeros(capture.count, bool), steady=True)


@pytest.mark.parametrize("gamma", [0.7, 1.1, 2.2])
def test_the_gamma_of_the_projector_is_stated_with_its_uncertainty(gamma: float) -> None:
    (finding,) = findings(grey_capture(1.0, gamma))
    assert finding.kind == "projector"
    measured, uncertainty = number(finding)
    assert abs(measured - gamma) <= max(uncertainty, 0.01 * gamma)
    assert uncertainty < 0.05 * gamma
    assert 'projector_response="auto"' in finding.advice


def test_the_gamma_of_the_camera_is_not_taken_for_that_of_the_projector() -> None:
    (finding,) = lm.check(grey_capture(2.2, 1.0))
    assert finding.kind == "response"
    assert number(finding)[0] == pytest.approx(2.2, rel=0.03)


def test_where_both_are_bent_no_number_is_stated() -> None:
    both = findings(grey_capture(2.2, 1.8))
    assert {each.kind for each in both} == {"response", "projector"}
    assert all("both gammas at once" in each.advice and "+-" not in each.message for each in both)


@pytest.mark.parametrize("scene", ["wall", "broad", "speckle"])
def test_intact_captures_of_grey_patterns_are_not_accused(scene: str) -> None:
    assert findings(draw(scene, "grey", "intact", 32, 0).capture) == []


def test_means_of_blocks_are_light() -> None:
    patterns = lm.BernoulliPatterns(PROJECTOR, K)
    decoder = lm.Decoder(clip=255, full_scale=255)
    capture = lm.Capture.from_arrays(patterns, photographs(patterns, noise=0.001), decoder)
    assert lm.check(capture.bin(projector=2)) == []


def test_rows_without_usable_samples_are_passed_over() -> None:
    # At the usual exposure, of some rows no prediction can be compared with a sample.
    greys = np.random.default_rng(0).random((40, 64, 64), np.float32)
    assert lm.check(lm.simulate("l_objects", lm.ImagePatterns(greys))) == []
