"""A projector's curve shows under random grey patterns, and is told from the camera's."""

from __future__ import annotations

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from tests.helpers.surface import PROJECTOR, photographs

K = 32
GREY = np.rint(255 * np.random.default_rng(3).random((K, *PROJECTOR))) / 255


def findings(camera: float, projector: float) -> list[lm.Finding]:
    """What is wrong with photographs by a camera and a projector of these gammas."""
    light = photographs(lm.ImagePatterns((GREY**projector).astype(np.float32)), noise=0.001) / 255
    frames = np.rint(255 * light ** (1 / camera)).astype(np.uint8)
    decoder = lm.Decoder(clip=255, full_scale=255)
    greys = lm.ImagePatterns(GREY.astype(np.float32))
    return lm.check(lm.Capture.from_arrays(greys, frames, decoder))


def stated(finding: lm.Finding) -> tuple[float, float]:
    """The gamma that a finding states, and its uncertainty."""
    words = finding.message.split()
    return float(words[-3]), float(words[-1])


@pytest.mark.parametrize("gamma", [0.7, 1.1, 2.2])
def test_the_gamma_of_the_projector_is_stated_with_its_uncertainty(gamma: float) -> None:
    (finding,) = findings(1.0, gamma)
    assert finding.kind == "projector"
    measured, uncertainty = stated(finding)
    assert abs(measured - gamma) <= max(uncertainty, 0.01 * gamma)
    assert uncertainty < 0.05 * gamma
    assert "--projector-response auto" in finding.advice


def test_the_gamma_of_the_camera_is_not_taken_for_that_of_the_projector() -> None:
    (finding,) = findings(2.2, 1.0)
    assert finding.kind == "response"
    assert stated(finding)[0] == pytest.approx(2.2, rel=0.03)


def test_where_both_are_bent_no_number_is_stated() -> None:
    both = findings(2.2, 1.8)
    assert {each.kind for each in both} == {"response", "projector"}
    assert all("both gammas at once" in each.advice and "+-" not in each.message for each in both)


def test_linear_light_is_left_alone() -> None:
    assert findings(1.0, 1.0) == []


@pytest.mark.parametrize("scene", ["wall", "broad", "speckle"])
def test_intact_captures_of_grey_patterns_are_not_accused(scene: str) -> None:
    capture = draw(scene, "grey", "intact", 32, 0).capture
    kinds = {each.kind for each in lm.check(capture)}
    assert not kinds & {"response", "projector"}


def test_means_of_blocks_are_light() -> None:
    patterns = lm.BernoulliPatterns(PROJECTOR, K)
    decoder = lm.Decoder(clip=255, full_scale=255)
    capture = lm.Capture.from_arrays(patterns, photographs(patterns, noise=0.001), decoder)
    assert lm.check(capture.bin(projector=2)) == []


def test_rows_without_usable_samples_are_passed_over() -> None:
    # At the usual exposure, of some rows no prediction can be compared with a sample.
    greys = np.random.default_rng(0).random((40, 64, 64), np.float32)
    assert lm.check(lm.simulate("l_objects", lm.ImagePatterns(greys))) == []
