"""Raw camera files: a DNG is light, black subtracted, linear, and 1 where the sensor clips."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.extras import exposure_time
from tests.helpers.camera_files import SECONDS, black_image, write_arw, write_nef

pytest.importorskip("rawpy")
BLACK, WHITE = 256, 4095
SHAPE = (24, 32)


def write_dng(file: Path, levels: NDArray[Any], seconds: float = 0.01) -> Path:
    """A DNG of a sensor with the filter RGGB, as the specification asks for it."""
    time = Fraction(seconds).limit_denominator(10_000)
    tags: list[tuple[int, str, int, Any, bool]] = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes([0, 1, 1, 2]), True),  # CFAPattern
        (33434, "2I", 1, (time.numerator, time.denominator), True),  # ExposureTime
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, "s", 0, "a camera of the tests", True),  # UniqueCameraModel
        (50714, "H", 1, BLACK, True),  # BlackLevel
        (50717, "H", 1, WHITE, True),  # WhiteLevel
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),  # Colours
        # A white balance that must not be used.
        (50728, "2I", 3, (1, 2, 1, 1, 2, 3), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1
    ]
    tifffile.imwrite(
        file, levels.astype(np.uint16), photometric="cfa", extratags=tags, metadata=None
    )
    return file


def mosaic_of(colours: NDArray[Any]) -> NDArray[Any]:
    """What a sensor with the filter RGGB sees of an image in colour."""
    seen = colours[..., 1].copy()
    seen[::2, ::2] = colours[::2, ::2, 0]
    seen[1::2, 1::2] = colours[1::2, 1::2, 2]
    return np.asarray(seen)


def levels(light: NDArray[Any]) -> NDArray[Any]:
    return np.rint(BLACK + np.clip(light, 0, 1) * (WHITE - BLACK))


def test_each_pixel_of_the_mosaic_is_its_light(tmp_path: Path) -> None:
    # Noise goes below black, and some pixels clip.
    light = np.random.default_rng(0).uniform(-0.02, 1.1, SHAPE)
    raw = np.rint(BLACK + np.minimum(light, 1) * (WHITE - BLACK))
    image = lm.read_image(write_dng(tmp_path / "a.dng", raw), mosaic=True)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, (raw - BLACK) / (WHITE - BLACK), atol=1e-6)
    assert image.min() < 0
    np.testing.assert_array_equal(image == 1, raw == WHITE)


def test_colours_are_interpolated_linearly(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    one, other = (random.uniform(0, 0.5, SHAPE) for _ in range(2))
    images = {}
    for name, light in (("one", one), ("other", other), ("both", one + other)):
        images[name] = lm.read_image(write_dng(tmp_path / f"{name}.dng", levels(light)))
    assert images["one"].shape == (*SHAPE, 3)
    # Light adds up, to rounding: no curve, no balance, nothing adaptive.
    np.testing.assert_allclose(images["one"] + images["other"], images["both"], atol=8e-4)
    # And what the filter let through is as it was.
    np.testing.assert_allclose(mosaic_of(images["both"]), one + other, atol=2e-4)
    flat = np.broadcast_to([0.1, 0.4, 0.8], (*SHAPE, 3))
    image = lm.read_image(write_dng(tmp_path / "flat.dng", levels(mosaic_of(flat))))
    np.testing.assert_allclose(image, flat, atol=2e-4)


@pytest.mark.parametrize(
    # LibRaw knows that Nikon's sensors clip below the end of the range.
    ("write", "name", "clip"),
    [(write_nef, "a.nef", 61247), (write_arw, "a.arw", 16383)],
)
def test_files_as_nikon_and_sony_lay_them_out(
    write: Callable[..., Path], name: str, clip: int, tmp_path: Path
) -> None:
    """Each of the four black levels is subtracted from its own pixels."""
    blacks = (512, 520, 530, 540)
    black = black_image((48, 64), blacks)
    electrons = np.random.default_rng(0).integers(-40, 9000, (48, 64))
    file = write(tmp_path / name, black + electrons, blacks)
    mosaic = lm.read_image(file, mosaic=True)
    np.testing.assert_allclose(mosaic, electrons / (clip - black), atol=1e-6)
    # The same light everywhere: what is interpolated is what is there.
    image = lm.read_image(write(tmp_path / name, black + 6000, blacks))
    assert image.shape == (48, 64, 3)
    spans = clip - np.array([blacks[0], max(blacks[1:3]), blacks[3]])
    np.testing.assert_allclose(image, np.broadcast_to(6000 / spans, image.shape), atol=1e-6)
    clipped = lm.read_image(write(tmp_path / name, np.full((48, 64), clip), blacks))
    assert clipped.min() >= 1 - 1e-6
    assert exposure_time(file) == pytest.approx(SECONDS[0] / SECONDS[1])
    file.write_bytes(file.read_bytes()[:4000])
    with pytest.raises(InputError, match=rf"{name}: cannot be read as an image"):
        lm.read_image(file)


@pytest.mark.parametrize("mosaic", [False, True])
def test_a_capture_of_raw_files(mosaic: bool, tmp_path: Path) -> None:
    patterns = lm.BernoulliPatterns((6, 6), 20)
    scene = np.random.default_rng(1).random((*SHAPE, 36)) / 10
    light = np.einsum("kn,rcn->krc", patterns.dense(), scene)
    place = tmp_path / "capture"
    (place / "images").mkdir(parents=True)
    lm.write_patterns(place / "patterns", patterns)
    for k, frame in enumerate(light):
        write_dng(place / "images" / f"{k}.dng", levels(frame))
    write_dng(tmp_path / "black.dng", np.full(SHAPE, BLACK))
    capture = lm.Capture.from_folders(
        place / "patterns",
        place / "images",
        lm.ReadSettings(black=tmp_path / "black.dng", mosaic=mosaic),
    )
    assert capture.camera_shape == (SHAPE if mosaic else (*SHAPE, 3))
    samples = capture.samples()
    assert samples.clipped.any()
    if mosaic:
        expected = light.clip(0, 1).reshape(20, -1).T
        np.testing.assert_allclose(samples.values, expected, atol=2e-4)
        np.testing.assert_array_equal(samples.clipped, expected >= 1 - 1e-4)
    content = {"format": "lightmatrix-capture", "version": 1, "mosaic": mosaic}
    (place / "capture.json").write_text(json.dumps(content))
    again = lm.Capture.open(place)
    np.testing.assert_array_equal(again.samples().values, samples.values)


def test_the_command_line_takes_the_mosaic(tmp_path: Path) -> None:
    lm.write_patterns(tmp_path / "patterns", lm.BernoulliPatterns((4, 4), 12))
    (tmp_path / "photos").mkdir()
    for k in range(12):
        light = np.random.default_rng(k).uniform(0, 0.9, (22, 24))
        write_dng(tmp_path / "photos" / f"{k}.dng", levels(light))
    line = f"estimate {tmp_path}/patterns {tmp_path}/photos --mosaic --bin-camera 8 --no-check"
    assert main([*line.split(), "-o", f"{tmp_path}/scene.zarr"]) == 0
    assert lm.open(tmp_path / "scene.zarr").camera_shape == (3, 3)


def test_responses_know_how_long_raw_files_were_exposed(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    # Smooth: colours are interpolated from neighbours, which must not clip before the pixel does.
    scene = np.geomspace(0.01, 1, 96)[None] * np.linspace(0.5, 1, 48)[:, None]
    times = [0.005, 0.01, 0.02, 0.04, 0.08]
    for k, time in enumerate(times):
        write_dng(tmp_path / f"{k}.dng", levels(scene * time / 0.01), time)
    response = lm.camera_response(tmp_path)
    np.testing.assert_allclose(response.exposures, times, rtol=1e-3)
    # A raw file is linear, so its gamma is 1.
    assert response.gamma == pytest.approx(1, abs=0.03)


def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_dng(tmp_path / "a.dng", np.full(SHAPE, 300))
    data = file.read_bytes()
    for cut in (len(data) // 2, len(data) - 300):
        (tmp_path / "cut.dng").write_bytes(data[:cut])
        with pytest.raises(InputError, match=r"cut\.dng: cannot be read as an image"):
            lm.read_image(tmp_path / "cut.dng")
    (tmp_path / "text.nef").write_text("no raw file")
    with pytest.raises(InputError, match=r"text\.nef: cannot be read as an image"):
        lm.read_image(tmp_path / "text.nef")
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(MissingExtraError, match=r"lightmatrix\[raw\]"):
        lm.read_image(file)
