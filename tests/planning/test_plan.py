"""The planner: its advice for a white frame, that the advice comes true, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.capture.capture import Capture
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.files.images import write_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.grey import fewest_frames
from lightmatrix.planning.exposure_advice import (
    RULES,
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
    single_clipped_share,
)
from lightmatrix.planning.plan import counts, expectations, plan
from lightmatrix.simulation.library import truth
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance


def _white(levels: object, clipped: object = False) -> WhiteFrame:
    values = np.asarray(levels, float)
    return WhiteFrame(values, np.broadcast_to(np.asarray(clipped), values.shape))


@given(st.floats(0.01, 100), st.floats(1, 500), st.floats(0, 0.02), st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_the_ladder_covers_the_scene_and_scales_with_it(
    light: float, contrast: float, noise: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    levels = light * np.exp(random.uniform(0, np.log(contrast), 2000))
    white = _white(levels)
    ladder = advise_exposures(white, noise)
    exposures = np.array([e for e, _ in ladder])
    assert sum(share for _, share in ladder) == pytest.approx(1)
    assert (np.diff(exposures) < 0).all()
    # The shortest clips no single response, the longest is quiet (or lights typical pixels fully).
    assert (RULES.bright_spot * levels * exposures[-1] > 1.01).mean() < 0.002
    assert single_clipped_share(white, ladder) < 0.002
    quiet = noise <= 1.01 * RULES.noise * white.typical * exposures[0]
    assert quiet or exposures[0] * white.typical >= 0.99
    other = [e for e, _ in advise_exposures(_white(3 * levels), noise)]
    np.testing.assert_allclose(3 * np.array(other), exposures, rtol=0.02)


def test_clipped_highlights_get_a_shorter_exposure() -> None:
    levels = np.r_[np.full(950, 0.5), np.ones(50)]
    known = advise_exposures(_white(levels))
    unknown = advise_exposures(_white(levels, levels == 1))
    assert unknown[-1][0] == pytest.approx(known[-1][0] / 4, rel=0.01)
    assert [share for _, share in unknown] == [0.75, 0.25]
    limited = advise_exposures(_white(levels), shortest=2.0)
    assert limited == [(2.0, 1.0)]
    assert single_clipped_share(_white(levels), limited) == pytest.approx(0.05)
    assert advise_density(_white(levels), limited) == 0.25
    assert advise_density(_white(levels), known) == 0.5


# The shares of clipped samples at 1, 2, 4 and 8 times the shortest advised exposure, as predicted
# from the white frame. `most` is the largest error allowed, `at_twice` that at twice the exposure
# (measured: 0.133, 0.015, 0.007, 0.097, 0.009, 0.007 and 0.036, 0.015, 0.004, 0.033, 0.009, 0.003).
@pytest.mark.parametrize(
    ("scene", "density", "most", "at_twice"),
    [
        ("l_objects", 0.5, 0.15, 0.04),
        ("gripper", 0.5, 0.02, 0.02),
        ("metal", 0.5, 0.008, 0.006),
        ("l_objects", 0.25, 0.11, 0.037),
        ("gripper", 0.25, 0.015, 0.015),
        ("metal", 0.25, 0.01, 0.005),
    ],
)
def test_the_white_frame_predicts_clipping(
    scene: str, density: float, most: float, at_twice: float
) -> None:
    known = truth(scene)
    white = _white(known.matrix.sum(axis=1))
    light = irradiance(known.matrix, BernoulliPatterns((64, 64), 32, density))[white.lit]
    shortest = advise_exposures(white)[-1][0]
    factors = (1, 2, 4, 8)
    predicted = np.array([clipped_share(white, factor * shortest, density) for factor in factors])
    real = np.array([float((factor * shortest * light >= 1).mean()) for factor in factors])
    # Only the brightest sums clip: 0.1 % of the samples of `l_objects`, 0.3 % as predicted.
    assert real[0] < 0.002
    assert predicted[0] < 0.004
    assert abs(predicted[1] - real[1]) < at_twice
    assert np.abs(predicted - real).max() < most
    assert (np.diff(predicted) >= 0).all()


def test_the_shortest_of_several_exposures_gets_few_frames_but_enough() -> None:
    white = _white(np.r_[np.full(990, 0.02), np.ones(10)])
    shares = {frames: advise_exposures(white, frames=frames)[-1][1] for frames in (8, 16, 24, 64)}
    longer = len(advise_exposures(white)) - 1
    assert longer >= 1
    assert shares == {8: 1 / (longer + 1), 16: 1 / (longer + 1), 24: 1 / 3, 64: 0.25}
    assert advise_exposures(white) == advise_exposures(white, frames=1000)


def test_pixels_the_projector_does_not_reach_do_not_count() -> None:
    levels = np.r_[np.zeros(9000), np.full(1000, 0.4)]
    assert advise_exposures(_white(levels)) == advise_exposures(_white(levels[9000:]))


def test_advice_comes_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The advised commands reach about the expected error, at a quarter of the size too."""
    assert main(["plan", "metal", "--size", "64", "-k", "64", "--json"]) == 0
    advice = json.loads(capsys.readouterr().out)
    assert advice["projector"] == [64, 64]
    for line in advice["commands"]:
        words = [
            str(tmp_path / w.rstrip("/")) if w in ("patterns/", "capture/", "scene.zarr") else w
            for w in line.split()[1:]
        ]
        more = ["--no-check", "--correct", "none"] if words[0] == "estimate" else []
        assert main([*words, *more]) == 0
    capsys.readouterr()
    content = json.loads((tmp_path / "capture" / "capture.json").read_text())
    assert content["exposure"] == pytest.approx(advice["exposure_of_frames"])
    plain = str(tmp_path / "scene.zarr")
    save = tmp_path / "T.npz"
    truth("metal").save(save)
    assert main(["evaluate", plain, "--truth", str(save), "--json"]) == 0
    error = json.loads(capsys.readouterr().out)["relative_error"]
    (least, worst) = next(e["relative_error"] for e in advice["expected"] if e["frames"] == 64)
    # 0.0207, and 0.0100 to 0.0236 are expected.
    assert 0.9 * least < error < 1.05 * worst


def test_a_photograph_is_read_with_its_black_and_clip(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random = np.random.default_rng(0)
    light = random.uniform(0.05, 0.25, (20, 30))
    raw = np.rint(16 + light * (4095 - 16)).astype(np.uint16)
    write_image(tmp_path / "white.png", raw)
    arguments = ["plan", str(tmp_path / "white.png"), "--clip", "4095", "--black", "16"]
    assert main([*arguments, "--json"]) == 0
    advice = json.loads(capsys.readouterr().out)
    assert advice["exposures"][-1]["exposure"] == pytest.approx(4 / RULES.bright_spot, rel=0.03)
    assert advice["projector"] == [128, 128]
    assert len(advice["exposure_of_frames"]) == advice["frames"]
    assert main([*arguments, "--size", "48x64", "-k", "40"]) == 0
    text = capsys.readouterr().out
    assert "patterns bernoulli -k 40 --size 48x64" in text
    assert "Error to expect" in text
    assert "128x128" not in text
    # Only capture.json can hold a black level.
    assert "estimate capture/ -o" in text
    assert "a capture.json with the" in text
    assert main([*arguments, "--exposure", "20", "--json"]) == 0
    milliseconds = json.loads(capsys.readouterr().out)["exposures"][-1]["exposure"]
    assert milliseconds == pytest.approx(20 * advice["exposures"][-1]["exposure"], rel=0.01)
    assert main([*arguments, "--shortest", "40"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "--density 0.25" in text
    assert "Dim the projector" in text


def test_two_folders_are_enough_for_photographs_of_one_exposure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = np.random.default_rng(0).integers(100, 200, (20, 20)).astype(np.uint8)
    write_image(tmp_path / "white.png", image)
    write_image(tmp_path / "black.png", np.full((20, 20), 3, np.uint8))
    black = str(tmp_path / "black.png")
    arguments = ["plan", str(tmp_path / "white.png"), "--black", black, "--response", "srgb"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "for a projector of 128x128; give the size of yours with --size" in text
    folders = f"estimate --patterns patterns/ --images photos/ --black {black} --response srgb"
    assert folders in text
    assert "capture/" not in text
    assert "* as advised" in text
    assert sum(line.lstrip().startswith("32 *") for line in text.splitlines()) == 1


def test_nothing_is_promised_below_the_fewest_measured_frames(
    capsys: pytest.CaptureFixture[str],
) -> None:
    fewest = counts()[0]
    assert expectations(fewest - 1) == []
    assert expectations(fewest) != []
    assert main(["plan", "metal", "--size", "64", "-k", "7"]) == 2
    assert "7 photographs do not tell 64 x 64 pixels apart" in capsys.readouterr().err
    with pytest.raises(InputError, match="do not tell 128 x 128 pixels apart"):
        plan(_white(np.full(9, 0.5)), frames=9)


def test_few_frames_get_grey_levels_and_a_warning_of_the_projectors_curve(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert [fewest_frames(n * n) for n in (32, 64, 128, 1024)] == [8, 8, 12, 16]
    assert main(["plan", "metal", "--size", "64", "-k", "8"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "patterns random -k 8 --size 64x64 -o" in text
    assert "gamma" in text
    advice = plan("metal", size=(64, 64), frames=8)
    assert len(np.unique(advice.make_patterns().images())) == 4
    assert max(e.relative_error[1] for e in advice.expected if e.frames == 8) < 0.2
    assert len(np.unique(plan("metal", size=(64, 64), frames=16).make_patterns().images())) == 2


def test_the_planned_capture_only_lacks_its_photographs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two exposures, a black frame and a clip level come true without a file written by hand."""
    light = np.random.default_rng(0).gamma(0.2, 100, (20, 30))
    frame = np.minimum(16 + light, 4000).astype(np.uint16)
    write_image(tmp_path / "white.png", frame)
    arguments = ["plan", str(tmp_path / "white.png"), "--clip", "4095", "--black", "16"]
    folder = tmp_path / "capture"
    arguments += ["--size", "8x8", "-k", "24", "-o", str(folder)]
    assert main([*arguments, "--json"]) == 0
    advice = json.loads(capsys.readouterr().out)
    assert len(advice["exposures"]) > 1
    for k in range(24):
        write_image(folder / "images" / f"{k:02}.png", frame)
    read = Capture.open(folder)
    np.testing.assert_allclose(read.exposures, advice["exposure_of_frames"])
    assert (read.decoder.clip, read.decoder.black_level) == (4095, 16)
    assert read.patterns.shape == (8, 8)
    assert main(arguments) == 2
    assert main(["plan", "metal", "--size", "64", "-o", str(folder)]) == 2
    assert "output with a scene" in capsys.readouterr().err


def test_a_partly_clipped_frame_is_warned_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = np.full((20, 20), 90, np.uint8)
    image[:4] = 255
    write_image(tmp_path / "white.png", image)
    assert main(["plan", str(tmp_path / "white.png")]) == 0
    assert "20.0 % of the white frame is clipped" in capsys.readouterr().out
    # A glint is no reason to take it again.
    image = np.full((100, 100), 100, np.uint8)
    image[0, 0] = 255
    write_image(tmp_path / "white.png", image, overwrite=True)
    assert main(["plan", str(tmp_path / "white.png")]) == 0
    assert "take it again" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("level", "message"),
    [
        (255, "100 % of the white frame is clipped"),
        (0, "white frame is dark: its bright pixels are at 0.0 %"),
        (1, "white frame is dark: its bright pixels are at 0.4 %"),
    ],
)
def test_dark_and_clipped_white_frames_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], level: int, message: str
) -> None:
    write_image(tmp_path / "white.png", np.full((8, 8), level, np.uint8))
    assert main(["plan", str(tmp_path / "white.png")]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("nowhere.png", "no such file"),
        (".", "is a folder"),
        ("nowhere.npz", "nowhere.npz"),
        ("l_objects --size 0", "0"),
        ("l_objects --black 3", "black with a scene"),
        ("l_objects --exposure 20", "exposure with a scene"),
        ("l_objects --size 64 --noise nan", "a noise of nan"),
        ("l_objects --size 64 --shortest 0", "a shortest exposure of 0"),
        ("l_objects --size 64 --error 2", "an error of 2"),
        ("T.npz --size 32", "8 x 8"),
    ],
)
def test_bad_plans_have_one_message(
    words: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    ProceduralScene((8, 8), (8, 8)).truth().save(tmp_path / "T.npz")
    assert main(["plan", *words.split()]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert error.startswith("error: ")
    assert message in error
    assert words != "nowhere.png" or "a photograph of a white pattern, a scene, or a T.npz" in error
