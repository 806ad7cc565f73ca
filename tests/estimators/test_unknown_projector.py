"""The projector's gamma is found in photographs of grey patterns, alone or with the camera's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.patterns.folder import write_patterns
from tests.helpers.surface import PROJECTOR, photographs

K = 32
GREY = np.rint(255 * np.random.default_rng(3).random((K, *PROJECTOR))) / 255


def capture(camera: float, projector: float) -> lm.Capture:
    """Photographs of the surface, with the grey values that the projector was sent as patterns."""
    light = photographs(lm.ImagePatterns((GREY**projector).astype(np.float32)), noise=0.001) / 255
    frames = np.rint(255 * light ** (1 / camera)).astype(np.uint8)
    decoder = lm.Decoder(clip=255, full_scale=255)
    return lm.Capture.from_arrays(lm.ImagePatterns(GREY.astype(np.float32)), frames, decoder)


@pytest.mark.parametrize("gamma", [0.8, 1.0, 1.8, 2.2])
def test_the_gamma_of_the_projector_is_found_with_a_known_camera(gamma: float) -> None:
    found = lm.find_projector_response(capture(1.0, gamma))
    assert found.projector is not None
    assert found.projector.gamma == pytest.approx(gamma, rel=0.01)
    assert found.response.name == "linear"
    assert found.projector_uncertainty < 0.02 * gamma


@pytest.mark.parametrize(("camera", "projector"), [(1.0, 1.0), (2.2, 2.2), (1.0, 1.8), (2.2, 1.4)])
def test_both_gammas_are_found_at_once(camera: float, projector: float) -> None:
    found = lm.find_projector_response(capture(camera, projector), camera=True)
    assert found.projector is not None
    assert found.gamma == pytest.approx(camera, rel=0.02)
    assert found.projector.gamma == pytest.approx(projector, rel=0.02)


def test_an_estimate_is_as_good_as_with_the_known_curves() -> None:
    taken = capture(2.2, 2.2)
    curve = lm.ProjectorResponse.of_gamma(2.2)
    known = lm.estimate(taken, response="gamma:2.2", projector_response=curve, check=False)
    found = lm.estimate(taken, response="auto", projector_response="auto", check=False)
    wrong = lm.estimate(taken, check=False)

    def off(transport: lm.LightTransport) -> float:
        whole = [each.to_matrix(dense_background=True) for each in (transport, known)]
        return float(np.linalg.norm((whole[0] - whole[1]).toarray()))

    assert off(found) < 0.1 * off(wrong)


def test_black_and_white_patterns_need_no_curve() -> None:
    patterns = lm.BernoulliPatterns(PROJECTOR, K)
    frames = photographs(patterns)
    taken = lm.Capture.from_arrays(patterns, frames, lm.Decoder(clip=255, full_scale=255))
    with pytest.raises(lm.InputError, match="need no curve"):
        lm.find_projector_response(taken)


def test_pictures_and_binned_grey_values_are_refused() -> None:
    taken = capture(1.0, 2.2)
    ramps = np.cumsum(np.random.default_rng(0).normal(size=(K, *PROJECTOR)), axis=2)
    ramps -= ramps.min(axis=2, keepdims=True)
    pictures = lm.ImagePatterns(ramps / ramps.max(axis=2, keepdims=True))
    with pytest.raises(lm.InputError, match="quotient"):
        lm.find_projector_response(lm.Capture(pictures, taken.frames, taken.decoder))
    with pytest.raises(lm.InputError, match="averaged"):
        lm.find_projector_response(taken.bin(projector=2))


def test_a_few_frames_determine_nothing() -> None:
    with pytest.raises(lm.InputError, match="do not determine"):
        lm.find_projector_response(capture(1.0, 2.2).select(np.arange(4)), camera=True)


def test_the_command_finds_both_gammas_of_a_capture_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from lightmatrix.cli import main

    taken = capture(2.2, 1.8)
    for number in range(K):
        lm.write_image(tmp_path / f"c/images/{number:03}.png", taken.frame(number))
    write_patterns(tmp_path / "c/patterns", taken.patterns)
    words = ["estimate", str(tmp_path / "c"), "-o", str(tmp_path / "scene.zarr"), "--json"]
    assert main([*words, "--response", "auto", "--projector-response", "auto"]) == 0
    printed = capsys.readouterr()
    response = json.loads(printed.out)["response"]
    assert response["gamma"] == pytest.approx(2.2, rel=0.02)
    assert response["projector_gamma"] == pytest.approx(1.8, rel=0.02)
    assert "the projector's gamma 1." in printed.err
