"""A rectangle of the photographs: the same samples as cut by hand, and known afterwards."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.regions import Region

CORNER, SHAPE = (11, 21), (24, 20)
WHOLE = (64, 64)
WORDS = "11,21:24x20"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture folder with a black frame and exposures of each frame."""
    place = tmp_path_factory.mktemp("crop") / "capture"
    simulated = lm.simulate(
        "metal", lm.BernoulliPatterns(WHOLE, 24), exposure="0.4:0.5,0.1:0.5", ambient=0.05
    )
    simulated.save(place)
    return place


def test_samples_are_those_of_the_rectangle(folder: Path) -> None:
    mask = np.zeros(WHOLE, np.uint8)
    mask[:30] = 255
    lm.write_image(folder.parent / "mask.png", mask)
    exposures = lm.Capture.open(folder).exposures
    whole = lm.Capture.from_folders(
        folder / "patterns",
        folder / "images",
        lm.ReadSettings(
            black=folder / "black.png",
            black_level=0,
            black_exposure=0.4,
            exposure=exposures,
            mask=folder.parent / "mask.png",
        ),
    )
    part = whole.crop(CORNER, SHAPE)
    assert part.camera_shape == SHAPE
    inside = np.arange(64 * 64).reshape(WHOLE)[11:35, 21:41].ravel()
    expected, samples = whole.samples().rows(inside), part.samples()
    for name in ("values", "clipped", "clip_level", "weights"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(expected, name))
    # Cut twice is cut once, and blocks of pixels begin at the corner.
    again = whole.crop((10, 20), (30, 30)).crop((1, 1), SHAPE)
    np.testing.assert_array_equal(again.samples().values, samples.values)
    assert again.description["crop"] == Region(CORNER, SHAPE, WHOLE).as_dict()
    binned = part.bin(camera=2).samples().values.reshape(12, 10, -1)
    inner = samples.values.reshape(12, 2, 10, 2, -1).mean(axis=(1, 3))
    masked = samples.weights_of_all().reshape(12, 2, 10, 2, -1).min(axis=(1, 3)) > 0
    np.testing.assert_allclose(binned[masked], inner[masked], rtol=1e-5, atol=1e-6)


def test_only_the_rectangle_of_a_photograph_stays_in_memory(folder: Path) -> None:
    frame = lm.Capture.open(folder, crop=(CORNER, SHAPE)).frame(3)
    assert frame.shape == SHAPE
    assert frame.base is None


@pytest.mark.parametrize(
    ("corner", "shape"), [((60, 0), (5, 5)), ((-1, 0), (5, 5)), ((0, 0), (0, 5)), ((0, 0), (65, 1))]
)
def test_a_crop_outside_the_photographs_is_refused(
    folder: Path, corner: tuple[int, int], shape: tuple[int, int]
) -> None:
    with pytest.raises(lm.InputError, match="crop of"):
        lm.Capture.open(folder, crop=(corner, shape))
    with pytest.raises(lm.InputError, match="binned already"):
        lm.Capture.open(folder, bin_camera=2).crop((0, 0), (2, 2))


def test_commands_know_the_place_of_a_crop(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = f"--patterns {folder}/patterns --images {folder}/images"
    stores: list[lm.LightTransport] = []
    for where in (f"{folder}", f"{plain} --black {folder}/black.png --black-exposure 0.4"):
        exposures = ",".join(f"{e:.17g}" for e in lm.Capture.open(folder).exposures)
        more = f"--exposure {exposures} --black-level 0" if "--patterns" in where else ""
        store = tmp_path / f"{len(stores)}.zarr"
        words = f"estimate {where} {more} --crop {WORDS} -o {store} --no-coherent --json"
        assert main([*words.split(), "--iterations", "5", "--no-check"]) == 0
        stores.append(lm.open(store))
    np.testing.assert_array_equal(stores[0].sparse.data, stores[1].sparse.data)
    assert stores[0].region == Region(CORNER, SHAPE, WHOLE)
    # The whole truth is cut alike, whether it is given as a file or as a scene.
    capsys.readouterr()
    truth = lm.truth(folder / "truth.npz").transport()
    truth = lm.LightTransport.from_matrix(
        truth.sparse[Region(CORNER, SHAPE, WHOLE).samples(WHOLE)], SHAPE, WHOLE
    )
    expected = lm.evaluate(stores[0], truth).relative_error
    assert expected < 0.9
    for source in (str(folder / "truth.npz"), "metal"):
        assert main(["evaluate", str(tmp_path / "0.zarr"), "--truth", source, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["relative_error"] == pytest.approx(expected)
    assert main(["info", str(tmp_path / "0.zarr")]) == 0
    assert "24 x 20 from 11, 21, of 64 x 64" in capsys.readouterr().out
    title = lm.show(stores[0], "row", 2, 3).axes[0].get_title()
    assert "13, 24 of the photographs" in title


def test_a_simulated_capture_keeps_its_truth() -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns(WHOLE, 8), exposure=0.5)
    part = capture.crop(CORNER, SHAPE)
    white = np.ones(WHOLE)
    whole = capture.truth.transport().relight(white)
    np.testing.assert_array_equal(part.truth.transport().relight(white), whole[11:35, 21:41])
    inside = Region(CORNER, SHAPE, WHOLE).samples(WHOLE)
    np.testing.assert_array_equal(
        part.truth.direct.sum(axis=1), capture.truth.direct[inside].sum(axis=1)
    )


@pytest.mark.parametrize("text", ["", "3", "1,2", "1,2:3", "a,b:cxd", "1,2:3x4:5", "-1,2:3x4"])
def test_malformed_crops_are_refused(
    text: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(folder), f"--crop={text}"]) == 2
    assert "400,600:768x1024" in capsys.readouterr().err


def test_jpeg_is_found_in_a_crop_beside_its_blocks(tmp_path: Path) -> None:
    simulated = lm.simulate("metal", lm.BernoulliPatterns(WHOLE, 24), exposure=0.3)
    images = tmp_path / "photos"
    images.mkdir()
    for k in range(24):
        Image.fromarray(simulated.frame(k)).save(images / f"{k:03d}.jpg", quality=60)
    findings = lm.check(
        patterns=simulated.patterns,
        images=images,
        settings=lm.ReadSettings(response="linear"),
        crop=((3, 5), (34, 35)),
    )
    assert "jpeg" in [finding.kind for finding in findings]


@pytest.mark.parametrize("block", [3, (2, 5)])
def test_photographs_are_binned_in_strips(
    block: int | tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which changes nothing, whatever clips, is masked, or has a black level of its own."""
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure="0.9:0.5,0.2:0.5",
                          ambient=0.1)  # fmt: skip
    mask = np.random.default_rng(0).random((64, 64)) > 0.1
    mask[:10, :10] = False
    whole = lm.Capture(capture.patterns, capture.frames, capture.decoder, mask)
    expected = whole.bin(camera=block).samples()
    monkeypatch.setattr("lightmatrix.capture.frames._STRIP", 500)
    binned = whole.bin(camera=block).samples()
    assert expected.clipped.any()
    for name in ("values", "clipped", "clip_level", "weights"):
        np.testing.assert_array_equal(getattr(binned, name), getattr(expected, name))
