"""T of a camera that is out of focus: `estimators/defocused.py`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import lightmatrix as lm
from lightmatrix.estimators.defocused import _gaussian, _Strip, defocused
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.rig_model.model import RigModel

pytestmark = pytest.mark.usefixtures("small_scenes")


def blurred(**options: Any) -> tuple[lm.Capture, lm.LightTransport, lm.Truth]:
    patterns = lm.BernoulliPatterns((32, 32), 32)
    capture = lm.simulate("l_objects", patterns, exposure=0.5, **options)
    first = lm.estimate(capture, check=False, correct="none", progress=False)
    return capture, first, capture.truth


@pytest.fixture(scope="module")
def unfocused() -> tuple[lm.Capture, lm.LightTransport, lm.Truth]:
    return blurred(camera_blur=1.0)


@pytest.fixture(scope="module")
def strip(unfocused: tuple[lm.Capture, lm.LightTransport, lm.Truth]) -> _Strip:
    return _Strip.of(*unfocused[:2], _gaussian(1.0), slice(5, 20))


def test_the_blur_is_found_and_t_is_estimated_with_it(
    unfocused: tuple[lm.Capture, lm.LightTransport, lm.Truth],
) -> None:
    capture, first, truth = unfocused
    with pytest.warns(lm.LightMatrixWarning, match=r"out of focus by 1\.0 of its pixels: corr"):
        transport = lm.estimate(capture, check=False, progress=False)
    before, after = (
        lm.evaluate(first, truth, exposure=0.5),
        lm.evaluate(transport, truth, exposure=0.5),
    )
    assert after.relative_error < 0.6 * before.relative_error
    assert after.relighting_error < 1.05 * before.relighting_error
    assert RigModel.of(transport).values["camera-blur"][0] == pytest.approx(1, abs=0.1)
    # What it says of its own error is near the truth.
    stated = OwnError(transport).stated
    assert stated is not None
    assert 0.5 < stated / after.relative_error < 3


@pytest.mark.parametrize(
    "options",
    [{}, pytest.param({"blur": 1.0}, marks=pytest.mark.slow)],
    ids=["sharp", "projector"],
)
def test_a_camera_in_focus_is_left_alone(options: dict[str, float]) -> None:
    capture, first, _ = blurred(**options)
    assert defocused(capture, first) is None


def test_a_strip_blurs_as_a_lens_does_and_has_an_adjoint(strip: _Strip) -> None:
    random = np.random.default_rng(0)
    images = random.random(strip.known.shape, np.float32)
    flat = images.reshape(15, 32, -1)
    expected = gaussian_filter(flat, (1, 1, 0), mode="nearest", truncate=3)
    assert strip.blurred(images).reshape(flat.shape) == pytest.approx(expected, abs=1e-5)
    light = random.random(strip.light.shape, np.float32)
    given = np.vdot(strip.shown(light, strip.columns), images)
    assert np.vdot(light, strip.gathered(images)) == pytest.approx(given, rel=1e-4)


def test_rows_give_what_the_strip_shows(strip: _Strip) -> None:
    capture = strip.solved()
    rows = capture.rows(1024)
    columns = capture.columns + capture.means
    patterns = np.zeros((1024, columns.shape[1]), np.float32)
    patterns[capture.pixels] = columns
    shown = capture.shown(capture.light, columns)
    assert rows.coefficients @ patterns == pytest.approx(shown, abs=2e-3 * float(shown.max()))


def test_light_is_a_minimum_of_the_objective(strip: _Strip) -> None:
    settled = strip._descended(1.0, 3000, 1e-5)
    left = settled.centred(settled.samples.values - settled.predicted)
    slope = -settled.gathered(left)
    lit = settled.light > 0.01 * settled.light.max()
    # The penalty is the same everywhere: it is minus the slope where there is light.
    penalty = -np.median(slope[lit])
    assert penalty > 0
    assert slope[lit] == pytest.approx(-penalty, abs=0.1 * float(penalty))
    assert slope.min() > -1.1 * penalty


def test_strips_without_light_or_samples_stay_as_they_are(strip: _Strip) -> None:
    dark = strip._at(strip.light < 0)
    assert dark.solved().light.size == 0
    unseen = replace(strip, known=np.zeros_like(strip.known))
    assert np.array_equal(unseen.solved().light, strip.light[strip.light > 0])


def test_a_camera_too_narrow_to_tell_a_blur_is_left_alone() -> None:
    scene = lm.ProceduralScene((12, 96), (32, 32)).truth()
    capture = lm.simulate(scene, lm.BernoulliPatterns((32, 32), 24), camera_blur=1.0)
    first = lm.estimate(capture, correct="none", check=False, progress=False)
    assert defocused(capture, first) is None
