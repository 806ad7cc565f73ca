"""T of a colour projector: one geometry for all channels and primaries, and gains of each pixel."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.estimators.colour import (
    ColourSamples,
    fit_gains,
    grey_capture,
    light_of_primaries,
    unmixed_capture,
)
from lightmatrix.simulation.realism import in_all_primaries

SIDE = 16
SCENE = lm.ProceduralScene((SIDE, SIDE), (SIDE, SIDE)).truth()
PATTERNS = lm.colour_bernoulli((SIDE, SIDE), 24, grey=8)
# Gains of each camera pixel, channel by primary: surfaces of many colours.
GAINS = np.random.default_rng(0).uniform(0.3, 1, (SIDE**2, 3, 1)) * np.array(
    [[1.0, 0.2, 0.05], [0.15, 0.9, 0.2], [0.05, 0.15, 0.8]]
)
SCALED = GAINS * (3 / GAINS.sum(axis=(1, 2), keepdims=True))


def _samples(clip: float = np.inf) -> tuple[ColourSamples, NDArray[np.float32]]:
    """Exact samples of the scene, cut off at a clip level, and the light of each primary."""
    light = light_of_primaries(SCENE.transport(), PATTERNS)
    values = np.einsum("nab,nbk->nak", SCALED, light).astype(np.float32)
    clipped = values >= clip
    ones = np.ones(values.shape, np.float32)
    return ColourSamples(PATTERNS, np.minimum(values, np.float32(clip)), clipped, ones), light


def test_gains_are_found_from_samples_that_do_not_clip() -> None:
    samples, light = _samples()
    lit = light.mean(axis=(1, 2)) > 0.1 * light.mean()
    np.testing.assert_allclose(fit_gains(samples, light, 1e-6)[lit], SCALED[lit], atol=2e-3)
    clip = float(np.quantile(samples.values, 0.95))
    samples, light = _samples(clip)
    off = np.abs(fit_gains(samples, light, 1e-6)[lit] - SCALED[lit])
    assert off.mean() < 2e-3
    ignored = replace(samples, clipped=np.zeros_like(samples.clipped))
    assert np.abs(fit_gains(ignored, light, 1e-6)[lit] - SCALED[lit]).mean() > 5e-3


def test_unmixed_samples_are_those_of_a_grey_camera() -> None:
    samples, _ = _samples()
    capture = unmixed_capture(samples, SCALED, (SIDE, SIDE), 1.0)
    assert capture.count == 8 + 3 * 16
    exact = SCENE.transport().multiplied(capture.patterns.dense().T)
    np.testing.assert_allclose(capture.samples().values, exact, atol=1e-3 * exact.max())
    grey = grey_capture(samples, (SIDE, SIDE), 1.0)
    exact = SCENE.transport().multiplied(grey.patterns.dense().T)
    white = SCALED.mean(axis=1).sum(axis=1)[:, None]
    np.testing.assert_allclose(grey.samples().values, white * exact, rtol=1e-3, atol=1e-5)


def test_clipped_samples_become_lower_bounds() -> None:
    whole, _ = _samples()
    samples, _ = _samples(float(np.quantile(whole.values, 0.9)))
    capture = unmixed_capture(samples, SCALED, (SIDE, SIDE), 1.0)
    read = capture.samples()
    exact = SCENE.transport().multiplied(capture.patterns.dense().T)
    assert read.clipped.mean() > 0.05
    slack = 2e-3 * exact.max()
    assert (read.values <= exact + slack)[read.clipped].all()
    # What is known stays right, and something else is left out.
    known = read.counted & ~read.clipped
    np.testing.assert_allclose(read.values[known], exact[known], atol=slack)
    assert 0 < (~read.counted).mean() < 0.3
    assert (read.values < exact - slack)[read.clipped].any()


def test_without_grey_patterns_a_usual_mixing_is_the_start() -> None:
    patterns = lm.colour_bernoulli((SIDE, SIDE), 24, grey=0)
    capture = lm.simulate(SCENE, patterns, exposure=0.3, bits=None)
    colour = lm.estimate_colour(capture, progress=False)
    assert lm.evaluate_colour(colour, capture.truth).relative_error < 0.08


def test_a_scene_is_relit_in_colour() -> None:
    wide = in_all_primaries(SCENE).transport()
    known = lm.ColourTransport(*(_part(wide, primary) for primary in range(3)))
    pictures = PATTERNS.colour_images(8, 11)
    side_by_side = PATTERNS.images(8, 11)
    np.testing.assert_allclose(known.relight(pictures), wide.relight(side_by_side), rtol=1e-5)
    np.testing.assert_allclose(known.relight(np.ones((SIDE, SIDE))), wide.relight(
        np.ones((SIDE, 3 * SIDE))), rtol=1e-5)  # fmt: skip
    dual = wide.dual(np.ones((SIDE, SIDE, 3)))
    np.testing.assert_allclose(
        known.dual_image(), dual.reshape(SIDE, 3, SIDE).swapaxes(1, 2), rtol=1e-5
    )
    with pytest.raises(InputError, match="colour projector"):
        known.relight(np.ones((SIDE, SIDE, 2)))


def test_a_truth_of_a_colour_projector_is_photographed_as_it_is() -> None:
    wide = in_all_primaries(SCENE)
    made, given = (lm.simulate(truth, PATTERNS, exposure=0.3) for truth in (SCENE, wide))
    np.testing.assert_array_equal(made.frame(20), given.frame(20))
    assert given.truth.projector_shape == (SIDE, 3 * SIDE)
    with pytest.raises(InputError, match="side by side"):
        lm.simulate(wide, PATTERNS, blur=1.0)


def _part(wide: lm.LightTransport, primary: int) -> lm.LightTransport:
    columns = np.arange(3 * SIDE**2).reshape(SIDE, 3, SIDE)[:, primary].ravel()
    return lm.LightTransport.from_matrix(wide.sparse[:, columns], wide.camera_shape, (SIDE, SIDE))


def test_grey_captures_are_refused_and_colour_ones_are_not_read_as_grey() -> None:
    capture = lm.simulate(SCENE, PATTERNS, exposure=0.3)
    with pytest.raises(InputError, match="three matrices"):
        lm.estimate(capture)
    grey = lm.simulate(SCENE, PATTERNS.red, exposure=0.3)
    with pytest.raises(InputError, match="grey, or of one colour"):
        lm.estimate_colour(grey)
    unknown = replace(capture.decoder, response=lm.Response.parse("auto"))
    for hidden in (replace(capture, decoder=unknown), replace(capture, projector_unknown=True)):
        with pytest.raises(InputError, match="to be found"):
            lm.estimate_colour(hidden)
    frames = np.stack([capture.frames.read(k)[..., 0] for k in range(capture.count)])
    one = lm.Capture.from_arrays(capture.patterns, frames, capture.decoder)
    with pytest.raises(InputError, match="without three channels"):
        lm.estimate_colour(one)
    with pytest.raises(InputError, match="leave out one"):
        lm.simulate(SCENE, PATTERNS, primary="red")


def _run(command: str) -> int:
    return main(command.split())


def test_the_commands_take_colour_from_patterns_to_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    SCENE.save(Path("T.npz"))
    command = f"patterns bernoulli --primary rgb -k 20 --grey 8 --size {SIDE} -o p"
    assert _run(command) == 0
    assert _run("simulate T.npz --patterns p --exposure 0.3 -o c") == 0
    assert _run("estimate c -o scene --no-check") == 0
    assert "red.zarr, green.zarr, blue.zarr in scene" in capsys.readouterr().out
    picture = np.random.default_rng(2).random((SIDE, SIDE, 3))
    lm.write_image("shown.png", picture, bits=16)
    assert _run("relight scene shown.png -o relit.tiff") == 0
    colour = lm.open_colour("scene")
    np.testing.assert_allclose(
        lm.read_image("relit.tiff"), colour.relight(lm.read_image("shown.png") / 65535), rtol=1e-4
    )
    assert _run("show scene dual -o dual.npz") == 0
    np.testing.assert_array_equal(np.load("dual.npz")["values"], colour.dual_image())
    capsys.readouterr()
    assert _run("evaluate scene --truth c --json") == 0
    errors = json.loads(capsys.readouterr().out)
    assert errors["relative_error"] < 0.1
    assert _run("estimate c -o other.zarr --no-check") == 2
    assert _run("estimate c -o other --solver romp --report r") == 2
    assert "--solver, --report for patterns in colour" in capsys.readouterr().err
    assert _run("show scene row 1,1 -o row.png") == 2
    assert _run("patterns hadamard --primary rgb -o q") == 2
    assert _run("patterns bernoulli --grey 3 -o q") == 2
