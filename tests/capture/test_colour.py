"""Colour all the way: cameras of three channels, and projectors of three primaries."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.files.images import read_grey
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.realism import FILTERS, in_primary

PATTERNS = lm.BernoulliPatterns((12, 12), 48)
COLOURS = ("red", "green", "blue")
# What the camera's red, green and blue see of a primary: filters overlap.
SEEN = {"red": (0.9, 0.2, 0.02), "green": (0.15, 0.8, 0.2), "blue": (0.02, 0.15, 0.7)}


def truth(seen: tuple[float, ...]) -> lm.LightTransport:
    """A scene whose surfaces have colours of their own, lit by one primary."""
    plain = ProceduralScene((12, 12), (12, 12)).truth().transport()
    surface = np.random.default_rng(0).uniform(0.2, 1, (144, 3))
    factor = (surface * np.array(seen)).astype(np.float32).ravel()
    pixel = np.repeat(np.arange(144), 3)
    sparse = csr_array(plain.sparse[pixel].multiply(factor[:, None]))
    background = plain.background[pixel] * factor[:, None]
    return lm.LightTransport(
        sparse.astype(np.float32), background, (12, 12, 3), plain.projector_shape
    )


def photographs(exact: lm.LightTransport, exposure: float) -> NDArray[np.uint8]:
    light = exposure * exact.relight(PATTERNS.images())
    noise = np.random.default_rng(1).normal(0, 0.003, light.shape)
    return np.rint(255 * np.clip(light + noise, 0, 1)).astype(np.uint8)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """Captures of the three primaries, an estimate of each, and their exposure."""
    place = tmp_path_factory.mktemp("colour")
    # As bright as leaves each single response below the clip level.
    exposure = 0.95 / max(float(truth(seen).sparse.max()) for seen in SEEN.values())
    for colour, seen in SEEN.items():
        lm.write_patterns(place / colour, PATTERNS, colour=colour)
        np.save(place / f"{colour}.npy", photographs(truth(seen), exposure))
        capture = lm.Capture.from_folders(
            place / colour, place / f"{colour}.npy", lm.ReadSettings(exposure=exposure)
        )
        lm.estimate(capture, output=place / f"{colour}.zarr", check=False, correct="none")
    return place, exposure


def _off(estimated: NDArray[np.float32], exact: NDArray[np.float32]) -> float:
    return float(np.linalg.norm(estimated - exact) / np.linalg.norm(exact))


def test_a_colour_scene_is_relit_in_colour(rig: tuple[Path, float]) -> None:
    place, _ = rig
    for colour, seen in SEEN.items():
        estimated, exact = lm.open(place / f"{colour}.zarr"), truth(seen)
        assert estimated.camera_shape == (12, 12, 3)
        stripes = np.zeros((12, 12))
        stripes[:, ::3] = 1
        assert _off(estimated.relight(stripes), exact.relight(stripes)) < 0.05
        # Each channel by itself, so that none is another's.
        for channel in np.argsort(seen)[1:]:
            off = _off(
                estimated.relight(stripes)[..., channel], exact.relight(stripes)[..., channel]
            )
            assert off < 0.08
        image = estimated.dual_image()
        assert image.shape == (12, 12, 3)
        assert _off(image, exact.dual_image()) < 0.06
        assert lm.evaluate(estimated, exact).as_dict()["relighting_error"] < 0.05


def test_a_colour_projector_is_three(rig: tuple[Path, float], tmp_path: Path) -> None:
    place, exposure = rig
    picture = np.random.default_rng(5).random((12, 12, 3))
    exact = sum(truth(seen).relight(picture[..., k]) for k, seen in enumerate(SEEN.values()))
    stores = [place / f"{colour}.zarr" for colour in COLOURS]
    estimated = lm.relight(stores, picture)
    assert _off(estimated, np.asarray(exact)) < 0.03
    swapped = lm.relight(stores[::-1], picture)
    assert _off(swapped, np.asarray(exact)) > 0.2
    white = lm.relight(stores, np.ones((12, 12)))
    np.testing.assert_allclose(white, lm.relight(stores, np.ones((12, 12, 3))), rtol=1e-6)
    # On the command line, bit for bit.
    lm.write_image(tmp_path / "shown.png", picture, bits=16)
    line = f"relight {place} {tmp_path}/shown.png --exposure {exposure} -o {tmp_path}/a.tiff"
    assert main(line.split()) == 0
    made = lm.relight(stores, tmp_path / "shown.png", exposure=exposure)
    np.testing.assert_array_equal(lm.read_image(tmp_path / "a.tiff"), made)


def test_three_matrices_are_evaluated_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    patterns = lm.BernoulliPatterns((16, 16), 8)
    scene = ProceduralScene((16, 16), (16, 16)).truth()
    captures = [lm.simulate(scene, patterns, primary=colour) for colour in COLOURS]
    exact = [one.truth.transport() for one in captures]
    # As each filter lets pass, and no light that is not the primary's.
    grey = scene.matrix.toarray()
    for k, one in enumerate(captures):
        assert one.camera_shape == (16, 16, 3)
        parts = one.truth.matrix.toarray().reshape(256, 3, 256)
        for channel in range(3):
            np.testing.assert_allclose(parts[:, channel], FILTERS[channel, k] * grey, rtol=1e-5)
        light = scene.direct_data.sum() * FILTERS[:, k].sum()
        assert one.truth.direct_data.sum() == pytest.approx(light, rel=1e-5)
    # A scene in colour reflects each primary as its own channel of T says.
    colourful = lm.Truth(
        csr_array(np.repeat(grey, 3, axis=0) * np.tile([[1], [2], [4]], (256, 1))),
        np.zeros(np.count_nonzero(grey) * 3, np.float32), (16, 16, 3), (16, 16),
    )  # fmt: skip
    blue = in_primary(colourful, "blue").matrix.toarray().reshape(256, 3, 256)
    np.testing.assert_allclose(blue[:, 1], 4 * FILTERS[1, 2] * grey, rtol=1e-5)

    # Green is a tenth too bright: known in all errors.
    wrong = [replace(one, sparse=one.sparse * np.float32(1 + 0.1 * (k == 1)))
             for k, one in enumerate(exact)]  # fmt: skip
    errors = lm.evaluate_colour(wrong, exact)
    assert errors.green.relative_error == pytest.approx(0.1, rel=1e-4)
    assert errors.red.relative_error == errors.blue.relative_error == 0
    energy = [float((one.sparse**2).sum()) for one in exact]
    expected = 0.1 * np.sqrt(energy[1] / sum(energy))
    assert errors.relative_error == pytest.approx(expected, rel=1e-4)
    assert 0.02 < errors.relighting_error < 0.1
    assert "green: error of T" in repr(errors)
    for k, colour in enumerate(COLOURS):
        captures[k].save(tmp_path / colour)
        lm.save(tmp_path / f"{colour}.zarr", wrong[k])
    assert main(f"evaluate {tmp_path} --truth {tmp_path} --json".split()) == 0
    assert json.loads(capsys.readouterr().out) == lm.evaluate_colour(wrong, exact).as_dict()
    with pytest.raises(InputError, match="2 truths"):
        lm.evaluate_colour(wrong, exact[:2])
    with pytest.raises(InputError, match="no primary 'pink'"):
        lm.simulate(scene, patterns, primary="pink")


def test_what_three_matrices_must_have_in_common(rig: tuple[Path, float]) -> None:
    red = lm.open(rig[0] / "red.zarr")
    with pytest.raises(InputError, match="2 matrices"):
        lm.relight([red, red], np.ones((12, 12)))
    with pytest.raises(InputError, match="matrices of camera_shape"):
        lm.relight([red, red, lm.truth("metal").transport()], np.ones((12, 12)))
    with pytest.raises(InputError, match="for a colour projector"):
        lm.relight([red, red, red], np.ones((12, 12, 2)))


def test_every_other_use_of_a_colour_matrix(
    rig: tuple[Path, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place, exposure = rig
    scene = place / "green.zarr"
    for view in ("dual", "column 5,7"):
        assert main(f"show {scene} {view} -o {tmp_path}/view.npy --overwrite".split()) == 0
        assert np.load(tmp_path / "view.npy").shape == (12, 12, 3)
    assert main(f"show {scene} row 5,7,1 -o {tmp_path}/row.npy".split()) == 0
    assert np.load(tmp_path / "row.npy").shape == (12, 12)
    assert main(f"show {scene} dual -o {tmp_path}/dual.png".split()) == 0
    assert main(f"export {scene} {tmp_path}/T.npz".split()) == 0
    assert lm.open(tmp_path / "T.npz").camera_shape == (12, 12, 3)
    lm.export(tmp_path / "truth.npz", truth(SEEN["green"]))
    capsys.readouterr()
    assert main(f"evaluate {scene} --truth {tmp_path}/truth.npz --json".split()) == 0
    assert json.loads(capsys.readouterr().out)["relative_error"] < 0.1
    line = f"check {place}/green {place}/green.npy --exposure {exposure}"
    assert main(line.split()) == 0
    with pytest.raises(InputError, match="no camera sample 5, 7"):
        lm.show(scene, "row", 5, 7)


def test_patterns_in_one_primary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = f"patterns bernoulli -k 8 --size 8 --primary green -o {tmp_path}/green"
    assert main(line.split()) == 0
    image = lm.read_image(tmp_path / "green" / "pattern_0003.png")
    assert image.shape == (8, 8, 3)
    assert not image[..., (0, 2)].any()
    assert isinstance(lm.read_patterns(tmp_path / "green"), lm.BernoulliPatterns)
    (tmp_path / "green" / "patterns.json").unlink()
    lit = lm.read_patterns(tmp_path / "green").images()
    np.testing.assert_array_equal(lit, lm.make_patterns("bernoulli", (8, 8), 8).images())
    lm.write_image(tmp_path / "green" / "pattern_0003.png", image[..., ::-1] * 0, overwrite=True)
    lm.read_patterns(tmp_path / "green")  # Black is of any colour.
    red = np.roll(image, 1, axis=2)
    lm.write_image(tmp_path / "green" / "pattern_0003.png", red, overwrite=True)
    with pytest.raises(InputError, match=r"0003\.png: is blue, but pattern_0000\.png is green"):
        lm.read_patterns(tmp_path / "green")
    lm.write_image(tmp_path / "green" / "pattern_0003.png", image + red, overwrite=True)
    # One that shows two at once is of a projector that mixes them.
    mixed = lm.read_patterns(tmp_path / "green")
    assert isinstance(mixed, lm.ColourPatterns)
    np.testing.assert_array_equal(mixed.colour_images()[3], (image + red) / 255)
    with pytest.raises(InputError, match=r"0003\.png: a pattern of several colours"):
        read_grey(tmp_path / "green" / "pattern_0003.png")
    with pytest.raises(InputError, match="patterns in 'pink'"):
        lm.write_patterns(tmp_path / "pink", PATTERNS, colour="pink")
