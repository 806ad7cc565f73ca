"""The projector's gamma is found in photographs of grey patterns, alone or with the camera's."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture.found_response import FoundResponse, with_response
from lightmatrix.cli import main
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


@pytest.mark.parametrize("gamma", [0.8, 2.2])
def test_the_gamma_of_the_projector_is_found_with_a_known_camera(gamma: float) -> None:
    found = lm.find_response(capture(1.0, gamma), projector=True)
    assert found.projector is not None
    assert found.projector.gamma == pytest.approx(gamma, rel=0.01)
    assert found.response.name == "linear"
    assert found.projector_uncertainty < 0.02 * gamma


def test_both_gammas_are_found_at_once() -> None:
    taken = with_response(capture(2.2, 1.4), lm.Response.parse("auto"))
    found = lm.find_response(taken, projector=True)
    assert found.projector is not None
    assert found.gamma == pytest.approx(2.2, rel=0.02)
    assert found.projector.gamma == pytest.approx(1.4, rel=0.02)


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_an_estimate_is_as_good_as_with_the_known_curves() -> None:
    taken = capture(2.2, 2.2)
    curve = lm.ProjectorResponse.of_gamma(2.2)
    quick = partial(lm.estimate, taken, coherent=False, iterations=9, check=False, correct="none")
    known = quick(response="gamma:2.2", projector_response=curve)
    found, wrong = quick(response="auto", projector_response="auto"), quick()

    def off(transport: lm.LightTransport) -> float:
        whole = [each.to_matrix(dense_background=True) for each in (transport, known)]
        return float(np.linalg.norm((whole[0] - whole[1]).toarray()))

    assert off(found) < 0.1 * off(wrong)


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_a_curve_that_was_found_does_not_spoil_the_verdict() -> None:
    taken = capture(1.0, 2.2)
    found = lm.estimate(taken, projector_response="auto", coherent=False, iterations=20)
    assert found.provenance["findings"] == []


def test_black_and_white_patterns_need_no_curve() -> None:
    patterns = lm.BernoulliPatterns(PROJECTOR, K)
    frames = photographs(patterns)
    taken = lm.Capture.from_arrays(patterns, frames, lm.Decoder(clip=255, full_scale=255))
    with pytest.raises(lm.InputError, match="need no curve"):
        lm.find_response(taken, projector=True)


def test_pictures_and_binned_grey_values_are_refused() -> None:
    taken = capture(1.0, 2.2)
    ramps = np.cumsum(np.random.default_rng(0).normal(size=(K, *PROJECTOR)), axis=2)
    ramps -= ramps.min(axis=2, keepdims=True)
    pictures = lm.ImagePatterns(ramps / ramps.max(axis=2, keepdims=True))
    with pytest.raises(lm.InputError, match="quotient"):
        lm.find_response(lm.Capture(pictures, taken.frames, taken.decoder), projector=True)
    with pytest.raises(lm.InputError, match="averaged"):
        lm.find_response(taken.bin(projector=2), projector=True)


def write_folder(folder: Path, taken: lm.Capture, **described: str) -> None:
    """A capture folder, with a capture.json if something is `described`."""
    for number in range(taken.count):
        lm.write_image(folder / f"images/{number:03}.png", taken.frame(number))
    write_patterns(folder / "patterns", taken.patterns)
    if described:
        content = {"format": "lightmatrix-capture", "version": 1, **described}
        (folder / "capture.json").write_text(json.dumps(content))


AUTOMATIC = {"response": "auto", "projector_response": "auto"}


@pytest.mark.parametrize("described", [{}, AUTOMATIC])
def test_the_command_finds_both_gammas_of_a_capture_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], described: dict[str, str]
) -> None:
    taken = capture(2.2, 1.8)
    write_folder(tmp_path / "c", taken, **described)
    options = [] if described else ["--response", "auto", "--projector-response", "auto"]
    words = ["estimate", str(tmp_path / "c"), "-o", str(tmp_path / "scene.zarr"), "--json"]
    assert main([*words, *options, "--no-check"]) == 0
    printed = capsys.readouterr()
    response = json.loads(printed.out)["response"]
    assert response["gamma"] == pytest.approx(2.2, rel=0.02)
    assert response["projector_gamma"] == pytest.approx(1.8, rel=0.02)
    assert "the projector's gamma 1." in printed.err


def test_a_capture_keeps_that_its_projector_is_unknown_until_the_curve_is_given(
    tmp_path: Path,
) -> None:
    taken = capture(1.0, 2.2)
    write_folder(tmp_path / "c", taken, **AUTOMATIC)
    opened = lm.Capture.open(tmp_path / "c", crop=((2, 2), (16, 16)))
    assert opened.projector_unknown
    assert opened.whole.projector_unknown
    assert opened.select([0, 2]).projector_unknown
    assert opened.patterns.digest == taken.patterns.digest
    settings = lm.ReadSettings(projector_response="auto")
    folders = tmp_path / "c/patterns", tmp_path / "c/images"
    assert lm.Capture.from_folders(*folders, settings).projector_unknown
    curve = lm.ProjectorResponse.of_gamma(2.2)
    found = FoundResponse(lm.Response(), 1, 0, 0, 0, curve).applied_to(opened)
    assert not found.projector_unknown
    assert found.patterns.digest == curve.light_of_patterns(taken.patterns).digest


def test_grey_values_are_packed_before_or_after_their_light_is_found(tmp_path: Path) -> None:
    taken = capture(1.0, 2.2)
    write_folder(tmp_path / "c", taken, projector_response="auto")
    lm.pack(tmp_path / "c", tmp_path / "unknown")
    opened = lm.Capture.open(tmp_path / "unknown")
    assert opened.projector_unknown
    assert opened.digest == lm.Capture.open(tmp_path / "c").digest
    found = lm.find_response(tmp_path / "c").applied_to(lm.Capture.open(tmp_path / "c"))
    lm.pack(found, tmp_path / "known")
    opened = lm.Capture.open(tmp_path / "known")
    assert not opened.projector_unknown
    assert opened.patterns.dense() == pytest.approx(GREY.reshape(K, -1) ** 2.2, abs=0.01)
    assert opened.digest == found.digest


def test_other_commands_refuse_grey_values_whose_light_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tmp_path / "c", capture(1.0, 2.2), **AUTOMATIC)
    assert main(["decode", str(tmp_path / "c"), "-o", str(tmp_path / "c.npz")]) == 2
    message = capsys.readouterr().err
    assert "to be found" in message or "only `estimate` finds it" in message
