"""Responses measured from photographs agree with known curves, within the stated errors."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import lightmatrix as lm
from benchmarks.response_curves import CURVES, TIMES, errors, srgb, stack
from lightmatrix.cli import main
from lightmatrix.errors import InputError, MissingExtraError

pytest.importorskip("cv2")


@pytest.mark.parametrize(
    ("name", "black", "clip"),
    [("linear", 20, 255), ("srgb", 0, 255), ("film", 0, 250), ("gamma", 256, 4095)],
)
def test_known_curves_are_recovered(name: str, black: int, clip: int) -> None:
    curve = CURVES[name]
    photographs = stack(curve, TIMES, black=black, clip=clip)
    measured = lm.camera_response(photographs, TIMES, black=float(black), clip=float(clip))
    off = errors(measured, curve, black, clip)
    # docs/response.md states these errors.
    assert np.abs(off).max() < 0.017
    assert np.sqrt((off**2).mean()) < 0.006
    assert measured.misfit < 0.005
    assert measured.uncertainty < 0.02
    if name == "gamma":
        assert measured.gamma == pytest.approx(2.2, rel=0.01)


def test_a_curve_makes_a_capture_linear(tmp_path: Path) -> None:
    """A curve is measured, written, and used for a capture that was taken with it."""
    patterns = lm.BernoulliPatterns((8, 8), 24)
    light = patterns.dense() @ np.random.default_rng(1).random((64, 90)) / 60
    frames = np.rint(255 * srgb(np.clip(light, 0, 1))).astype(np.uint8).reshape(24, 9, 10)
    lm.camera_response(stack(srgb, TIMES), TIMES, output=tmp_path / "curve.json")
    place = tmp_path / "capture"
    (place / "images").mkdir(parents=True)
    lm.write_patterns(place / "patterns", patterns)
    for k, frame in enumerate(frames):
        lm.write_image(place / "images" / f"{k}.png", frame)
    description = {"format": "lightmatrix-capture", "version": 1, "response": "curve.json"}
    (place / "capture.json").write_text(json.dumps(description))
    (place / "curve.json").write_bytes((tmp_path / "curve.json").read_bytes())
    samples = lm.Capture.open(place).samples()
    np.testing.assert_allclose(samples.values.T.ravel(), light.clip(0, 1).ravel(), atol=0.02)
    plain = lm.Capture.from_folders(
        place / "patterns", place / "images", lm.ReadSettings(response=str(tmp_path / "curve.json"))
    )
    np.testing.assert_array_equal(plain.samples().values, samples.values)


def test_a_curve_of_float_photographs_says_what_they_need(tmp_path: Path) -> None:
    photographs = stack(srgb, TIMES).astype(np.float32)
    lm.camera_response(photographs, TIMES, clip=255, output=tmp_path / "curve.json")
    settings = lm.ReadSettings(response=str(tmp_path / "curve.json"))
    np.save(tmp_path / "p.npy", lm.BernoulliPatterns((8, 8), len(photographs)).images())
    np.save(tmp_path / "i.npy", photographs)
    folders = tmp_path / "p.npy", tmp_path / "i.npy"
    with pytest.raises(lm.InputError, match="up to 255 for images of float32") as caught:
        lm.Capture.from_folders(*folders, settings)
    assert "clip=255 if" in str(caught.value.hint)
    opened = lm.Capture.from_folders(*folders, replace(settings, clip=255))
    assert 0.9 < opened.samples().values.max() <= 1
    with pytest.raises(lm.InputError, match="clip is abc"):
        lm.camera_response(photographs, TIMES, clip="abc")  # type: ignore[arg-type]


def test_a_curve_states_the_levels_that_it_was_measured_from(tmp_path: Path) -> None:
    photographs = stack(CURVES["gamma"], TIMES, clip=4095)
    lm.camera_response(photographs, TIMES, clip=4095, output=tmp_path / "curve.json")
    np.save(tmp_path / "p.npy", lm.BernoulliPatterns((8, 8), 7).images())
    np.save(tmp_path / "i.npy", photographs)

    def opened() -> lm.Capture:
        return lm.Capture.from_folders(
            tmp_path / "p.npy",
            tmp_path / "i.npy",
            lm.ReadSettings(response=str(tmp_path / "curve.json")),
        )

    capture = opened()
    assert (capture.decoder.full_scale, capture.decoder.clip) == (4095, 4095)
    # Another full scale leaves the light of each level unchanged.
    restated = lm.Capture.from_folders(
        tmp_path / "p.npy",
        tmp_path / "i.npy",
        lm.ReadSettings(response=str(tmp_path / "curve.json"), full_scale=65535, clip=4095),
    )
    np.testing.assert_allclose(restated.samples().values, capture.samples().values, atol=1e-6)
    np.save(tmp_path / "i.npy", stack(CURVES["gamma"], TIMES))
    with pytest.raises(InputError, match="levels up to 4095 for images of uint8"):
        opened()


def test_exposures_come_from_the_files(tmp_path: Path) -> None:
    for k, (time, image) in enumerate(zip(TIMES, stack(srgb, TIMES), strict=True)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x829A] = time / 100
        Image.fromarray(image).save(tmp_path / f"{k}.jpg", quality=98, exif=exif)
    measured = lm.camera_response(tmp_path)
    np.testing.assert_allclose(measured.exposures, np.array(TIMES) / 100)
    assert np.abs(errors(measured, srgb, 0, 255)).max() < 0.03
    Image.fromarray(image).save(tmp_path / "3.jpg")
    with pytest.raises(InputError, match=r"3\.jpg: the exposures of the photographs are unknown"):
        lm.camera_response(tmp_path)


def test_channels_that_differ_are_noticed() -> None:
    colour = np.stack(
        [stack(CURVES[name], TIMES[2:]) for name in ("gamma", "gamma", "film")], axis=3
    )
    same = np.stack(
        [stack(srgb, TIMES[2:], noise=noise) for noise in (0.004, 0.005, 0.006)], axis=3
    )
    differ = lm.camera_response(colour, TIMES[2:]).channels
    alike = lm.camera_response(same, TIMES[2:]).channels
    assert differ is not None
    assert alike is not None
    assert differ > 0.03 > 0.015 > alike


def _ramp(gamma: float, count: int = 9) -> NDArray[Any]:
    light = np.linspace(0, 1, count)[:, None, None] ** gamma
    scene = np.random.default_rng(0).uniform(0.05, 0.9, (20, 30))
    return np.rint(10 + 240 * light * scene).astype(np.uint8)


def test_the_projectors_gamma_is_found_and_used(tmp_path: Path) -> None:
    measured = lm.projector_response(
        _ramp(1.8), output=tmp_path / "p.json", picture=tmp_path / "p.png"
    )
    assert measured.gamma == pytest.approx(1.8, rel=0.01)
    assert lm.ProjectorResponse.load(tmp_path / "p.json").levels == measured.levels
    grey = np.linspace(0, 1, 100)
    np.testing.assert_allclose(measured.light_of(grey), grey**1.8, atol=0.006)
    # A photograph through the camera's own curve.
    bent = np.rint(255 * (_ramp(1.8) / 255) ** (1 / 2.2)).astype(np.uint8)
    through = lm.projector_response(bent, response="gamma:2.2")
    assert through.gamma == pytest.approx(1.8, rel=0.02)
    # Patterns of black and white are what they are; grey ones become light.
    shown = lm.ImagePatterns(np.linspace(0, 1, 128, dtype=np.float32).reshape(2, 8, 8))
    np.save(tmp_path / "patterns.npy", shown.images())
    np.save(tmp_path / "images.npy", np.full((2, 4, 4), 100, np.uint8))
    capture = lm.Capture.from_folders(
        tmp_path / "patterns.npy",
        tmp_path / "images.npy",
        lm.ReadSettings(projector_response=tmp_path / "p.json"),
    )
    np.testing.assert_allclose(capture.patterns.images(), shown.images() ** 1.8, atol=0.006)
    bits = lm.BernoulliPatterns((8, 8), 4)
    assert measured.light_of_patterns(bits) is bits


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("{}/s.npy", "the exposures of the photographs are unknown"),
        ("{}/s.npy --exposure 1,2", "2 exposures for 7 photographs"),
        ("{}/s.npy --exposure 1,1,1,2,2,2,2", "photographs of 2 exposures from 1 to 2"),
        ("{}/s.npy --exposure 8,4,2,1,0.5,0.25,0.125", "is darker than"),
        ("{}/s.npy --exposure {t} --clip 300", "correct black or clip"),
        ("{}/s.npy --exposure {t} --levels 0,255", "--levels for a camera's curve"),
        ("{}/s.npy --exposure {t} --projector", "--exposure for a projector's curve"),
        ("{}/dark.npy --exposure {t}", "neither dark nor clipped at two exposures"),
        ("{}/s.npy --projector --levels 0,10", "2 grey values for 7 photographs"),
        ("{}/dark.npy --projector", "pixels that the projector lights"),
        ("{}/nothing --exposure 1,2,4", "no such folder"),
    ],
)
def test_unusable_photographs_are_refused(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "s.npy", stack(srgb, TIMES))
    np.save(tmp_path / "dark.npy", np.full((7, 20, 20), 2, np.uint8))
    line = words.replace("{}", str(tmp_path)).replace("{t}", ",".join(map(str, TIMES)))
    assert main(f"response {line} -o {tmp_path}/curve.json".split()) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "curve.json").exists()


def test_other_files_are_refused_as_curves(tmp_path: Path) -> None:
    good = {
        "format": "lightmatrix-response", "version": 1, "device": "camera",
        "levels": [0, 100, 255], "light": [0, 0.2, 1],
    }  # fmt: skip
    for change, message in (
        ({"device": "projector"}, "is the response of a projector, not of a camera"),
        ({"levels": [0, 0, 255]}, "holds no curve"),
        ({"light": [0, 0.5, True]}, "holds no curve"),
        ({"light": [0, 0.5]}, "holds no curve"),
        ({"light": [0, 0.5, 0.4]}, "holds no curve"),
        ({"version": 2}, "has format version 2"),
        ({"format": "x"}, "is not a lightmatrix-response file"),
    ):
        (tmp_path / "c.json").write_text(json.dumps({**good, **change}))
        with pytest.raises(InputError, match=message):
            lm.Response.parse("c.json", tmp_path)
    with pytest.raises(InputError, match="no such file"):
        lm.Response.parse(str(tmp_path / "nothing.json"))


def test_without_opencv_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match=r"lightmatrix\[response\]"):
        lm.camera_response(stack(srgb, TIMES), TIMES)


@pytest.mark.parametrize("clip", [np.nan, -5, "high"])
def test_a_clip_level_that_is_no_level(clip: Any) -> None:
    light = np.linspace(0, 250, 9)[:, None, None] * np.ones((9, 10, 10))
    with pytest.raises(lm.InputError, match="clip is"):
        lm.projector_response(light.astype(np.uint8), clip=clip)
