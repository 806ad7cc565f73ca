"""The camera's response is found in the photographs of a capture, and used when asked."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import lightmatrix as lm
from experiments.responses import photographed
from lightmatrix.capture.found_response import (
    FoundResponse,
    bends,
    bent,
    exponent,
    largest_difference,
    points,
    raised,
    with_response,
)
from lightmatrix.estimators.camera_window import window_of_levels
from lightmatrix.estimators.unknown_response import Curves, refined
from lightmatrix.simulation.realism import defocus
from tests.helpers.surface import PROJECTOR, photographs

K = 32
PATTERNS = lm.BernoulliPatterns(PROJECTOR, K)
LEVELS = photographs(PATTERNS, noise=0.001) / 255
S_CURVE = "s-curve"


def response(name: str) -> lm.Response:
    if name != S_CURVE:
        return lm.Response.parse(name)
    levels = np.linspace(0, 1, 4097)
    return lm.Response(levels, 0.5 * levels + 0.5 * (3 * levels**2 - 2 * levels**3), name)


def coded(name: str) -> lm.Capture:
    """Photographs of the surface by a camera of some response, read as linear ones."""
    known = response(name)
    shares = LEVELS
    if known.levels is not None and known.light is not None:
        shares = np.interp(LEVELS, known.light, known.levels)
    frames = np.rint(255 * shares).astype(np.uint8)
    return lm.Capture.from_arrays(PATTERNS, frames, lm.Decoder(clip=255, full_scale=255))


@pytest.mark.parametrize("name", ["linear", "gamma:0.8", "srgb", S_CURVE])
def test_the_curve_is_found_by_few_estimates(name: str) -> None:
    found = lm.find_response(coded(name))
    assert largest_difference(found.response, response(name)) < 0.02
    assert found.estimates <= 5
    # So few camera pixels do not tell sRGB from a gamma.
    assert found.is_gamma == (name != S_CURVE)
    if name not in (S_CURVE, "srgb"):
        true = 1.0 if name == "linear" else float(name.removeprefix("gamma:"))
        assert found.gamma == pytest.approx(true, rel=0.02)
        assert found.uncertainty < 0.05 * true


def test_a_gamma_that_is_not_near_does_not_become_a_curve() -> None:
    """The T of a wrong gamma bends in other ways, too; so the gamma is corrected first."""
    read = with_response(coded("gamma:0.8"), response("gamma:1.1"))
    transport = lm.estimate(read, check=False, correct="none")
    better = refined(read, transport, Curves(read.decoder.response))
    assert better is not None
    assert not better.curved
    assert exponent(better.response) == pytest.approx(0.8, rel=0.06)


def test_a_search_that_ends_at_a_wrong_gamma_is_repeated_by_predictions() -> None:
    """Under 16 patterns a blurred T of a wrong gamma leaves no bend, but predicts badly.

    The first search ends below 1.5.
    """
    truth = defocus(lm.truth("metal"), 1.0)
    # Half of the frames short, as the planner advises.
    whole, _ = photographed(truth, 16, "0.587:0.5,0.146:0.5", response("gamma:2.2"))
    capture = whole.crop((20, 20), (16, 16))
    found = lm.find_response(capture)
    assert found.gamma == pytest.approx(2.2, rel=0.04)
    assert found.estimates <= 24


def test_the_window_shows_many_levels_and_not_only_bright_ones() -> None:
    """A bright wall holds two levels; beside it are a scene of many, and a dark corner."""
    random = np.random.default_rng(0)
    albedo = np.full((24, 60), 0.95)
    albedo[:, 20:40] = random.uniform(0.2, 1, (24, 20))
    albedo[:, 40:] = random.uniform(0, 0.05, (24, 20))
    frames = np.rint(255 * albedo * random.integers(0, 2, (K, 24, 60))).astype(np.uint8)
    capture = lm.Capture.from_arrays(PATTERNS, frames, lm.Decoder(clip=255, full_scale=255))
    window = window_of_levels(capture, 16)
    _, left = window.description["crop"]["corner"]
    assert window.camera_shape == (16, 16)
    assert 20 <= left <= 24
    small = coded("linear")
    assert window_of_levels(small) is small


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_an_estimate_uses_the_curve_when_asked() -> None:
    capture = coded("gamma:2.2")
    quick = partial(lm.estimate, capture, coherent=False, iterations=9, check=False, correct="none")
    known, automatic, wrong = quick(response="gamma:2.2"), quick(response="auto"), quick()

    def off(transport: lm.LightTransport) -> float:
        difference = transport.to_matrix(dense_background=True) - known.to_matrix(
            dense_background=True
        )
        return float(np.linalg.norm(difference.toarray()))

    assert off(automatic) < 0.1 * off(wrong)


def test_a_camera_of_12_bits_in_files_of_16_is_linear() -> None:
    """Its clip level is a sixteenth of full scale, and faint light is less still."""
    levels = 0.7 * LEVELS
    frames = (64 + np.rint((4095 - 64) * levels)).astype(np.uint16)
    decoder = lm.Decoder(clip=4095, full_scale=65535, black_level=64)
    capture = lm.Capture.from_arrays(PATTERNS, frames, decoder)
    better = refined(capture, lm.estimate(capture, check=False), Curves(lm.Response()))
    assert better is not None
    assert exponent(better.response) == pytest.approx(1, abs=0.02)


def test_linear_photographs_stay_as_they_are() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", lm.LightMatrixWarning)
        lm.estimate(coded("linear"))


def test_a_few_frames_determine_nothing() -> None:
    with pytest.raises(lm.InputError, match="do not determine"):
        lm.find_response(coded("gamma:2.2").select(np.arange(4)))


def test_jpeg_is_a_gamma_with_a_warning(tmp_path: Path) -> None:
    capture = coded("gamma:2.2")
    for number in range(K):
        image = Image.fromarray(capture.frame(number))
        (tmp_path / "images").mkdir(exist_ok=True)
        image.save(tmp_path / f"images/{number:03}.jpg", quality=100, subsampling=0)
    settings = lm.ReadSettings(response="auto")
    read = lm.Capture.from_folders(PATTERNS, tmp_path / "images", settings)
    with pytest.warns(lm.LightMatrixWarning, match="JPEG"):
        found = lm.find_response(read)
    assert found.is_gamma
    assert found.gamma == pytest.approx(2.2, rel=0.1)


def test_a_found_curve_is_saved_as_any_other(tmp_path: Path) -> None:
    curve = response(S_CURVE)
    found = FoundResponse(curve, 1.1, 0.01, 0.1, 2)
    found.save(tmp_path / "curve.json")
    read = lm.Response.parse(str(tmp_path / "curve.json"))
    assert largest_difference(read, curve) < 1e-3


def test_bends_change_a_curve_as_they_say() -> None:
    curve = lm.Response.parse("gamma:2")
    levels, light = points(curve)
    assert points(raised(curve, 1.1))[1] == pytest.approx(levels**2.2, abs=1e-6)
    small = 1e-3
    for number, shape in enumerate(bends(curve, levels)):
        changed = points(bent(curve, small * np.eye(3)[number]))[1] - light
        assert changed == pytest.approx(small * shape, abs=small * 0.03)
    strong = bent(curve, np.array([0.0, 5.0, 0.0]))
    assert (np.diff(points(strong)[1]) > 0).all()
