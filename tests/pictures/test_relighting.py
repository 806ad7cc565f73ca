"""Patterns of another size than the projector of T."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main


@pytest.fixture(scope="module")
def binned() -> lm.LightTransport:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.2)
    return lm.estimate(capture.bin(projector=(8, 4), camera=8), coherent=False, iterations=2)


def test_a_pattern_of_the_projector_before_binning_is_averaged(binned: lm.LightTransport) -> None:
    pattern = np.random.default_rng(0).random((64, 64))
    means = pattern.reshape(8, 8, 16, 4).mean(axis=(1, 3))
    image = lm.relight(binned, pattern)
    np.testing.assert_allclose(image, binned.relight(means), rtol=1e-5, atol=1e-7)


def test_other_sizes_are_resized_if_asked(
    binned: lm.LightTransport, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for shape in ((5, 7), (100, 90), (16, 16)):
        with pytest.raises(lm.InputError, match="for a projector of 8 x 16"):
            lm.relight(binned, np.ones(shape))
        even = lm.relight(binned, np.full(shape, 0.5), resize=True)
        np.testing.assert_allclose(even, binned.relight(np.full((8, 16), 0.5)), rtol=1e-4)
    lm.save(tmp_path / "scene.zarr", binned)
    lm.write_image(tmp_path / "pattern.png", np.full((33, 20), 255, np.uint8))
    words = ["relight", str(tmp_path / "scene.zarr"), str(tmp_path / "pattern.png")]
    assert main([*words, "-o", str(tmp_path / "relit.npy")]) == 2
    message = capsys.readouterr().err
    assert "--resize" in message
    assert "pattern.png: a pattern of shape (33, 20)" in " ".join(message.split())
    assert main([*words, "-o", str(tmp_path / "relit.npy"), "--resize"]) == 0
    np.testing.assert_allclose(
        lm.read_image(tmp_path / "relit.npy"), binned.relight(np.ones((8, 16))), rtol=1e-4
    )


def test_shrinking_keeps_the_light(binned: lm.LightTransport) -> None:
    """Averaged, not sampled: fine stripes become grey."""
    stripes = np.zeros((24, 48))
    stripes[:, ::3] = 1
    image = lm.relight(binned, stripes, resize=True)
    np.testing.assert_allclose(image, binned.relight(np.full((8, 16), 1 / 3)), rtol=1e-3)


def test_a_png_is_coded_for_a_display_and_other_files_are_linear(
    binned: lm.LightTransport, tmp_path: Path
) -> None:
    pattern = np.full((8, 16), 0.5)
    light = np.clip(binned.relight(pattern), 0, 1)
    lm.relight(binned, pattern, output=tmp_path / "shown.png")
    shown = lm.read_image(tmp_path / "shown.png") / 255
    np.testing.assert_allclose(shown, light ** (1 / 2.2), atol=0.003)
    lm.relight(binned, pattern, gamma=1, output=tmp_path / "linear.png")
    np.testing.assert_allclose(lm.read_image(tmp_path / "linear.png") / 255, light, atol=0.003)
    lm.relight(binned, pattern, output=tmp_path / "values.npy")
    np.testing.assert_allclose(lm.read_image(tmp_path / "values.npy"), binned.relight(pattern))
    with pytest.raises(lm.InputError, match=r"a gamma of 2\.2 for .*values\.tiff"):
        lm.relight(binned, pattern, gamma=2.2, output=tmp_path / "values.tiff")


def test_an_image_beyond_single_precision_is_refused(tmp_path: Path) -> None:
    bright = lm.LightTransport.from_matrix(np.full((4, 4), 1e38), (2, 2), (2, 2))
    lm.save(tmp_path / "scene.zarr", bright)
    lm.write_image(tmp_path / "pattern.png", np.full((2, 2), 255, np.uint8))
    words = ["relight", str(tmp_path / "scene.zarr"), str(tmp_path / "pattern.png")]
    assert main([*words, "-o", str(tmp_path / "relit.png"), "--exposure", "1e9"]) == 2
    assert not (tmp_path / "relit.png").exists()
