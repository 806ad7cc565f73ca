"""What real rigs do wrong, in simulated photographs: each fault does what its name says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.simulation.faults import FAULTS
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import Truth

Frames = NDArray[np.float32]
COUNT, SHAPE, EXPOSURE = 12, (20, 18), 0.1
GREY = lm.ImagePatterns(np.random.default_rng(0).uniform(0, 1, (COUNT, 12, 10)).astype(np.float32))
BLACK_AND_WHITE = lm.BernoulliPatterns((12, 10), COUNT, seed=3)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return ProceduralScene(SHAPE, (12, 10), seed=2).truth()


def taken(truth: Truth, patterns: lm.PatternSet = GREY, **settings: Any) -> Frames:
    """Noise-free samples at the camera, (K, rows, cols); exposure 1 is the clip level."""
    capture = lm.simulate(truth, patterns, exposure=EXPOSURE, bits=None, noise=0, **settings)
    return np.stack([capture.frame(k) for k in range(capture.count)])


def emitting(truth: Truth, emitted: NDArray[Any]) -> Frames:
    """The samples of a rig that emits exactly this."""
    return taken(truth, lm.ImagePatterns(emitted))


def lagging(truth: Truth, still: Frames) -> Frames:
    return np.asarray(0.8 * still + 0.2 * np.concatenate([still[:1], still[:-1]]), np.float32)


def torn(truth: Truth, still: Frames) -> Frames:
    torn = still.copy()
    torn[1:, 15:] = still[:-1, 15:]
    return torn


def dimmed(shown: NDArray[Any]) -> NDArray[Any]:
    """Crosstalk of 0.3, pixel by pixel."""
    result = np.empty_like(shown)
    rows, cols = shown.shape[1:]
    for k, row, col in np.ndindex(shown.shape):
        beside = [
            shown[k, min(max(row + down, 0), rows - 1), min(max(col + right, 0), cols - 1)]
            for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1))
        ]
        result[k, row, col] = shown[k, row, col] * (1 - 0.3 * (1 - np.mean(beside)))
    return result


def ramp(number: float) -> NDArray[Any]:
    return np.linspace(0, number, COUNT)[:, None, None]


LATE = (np.arange(COUNT) >= COUNT // 2)[:, None, None]
# What the frames are exactly, as a function of the truth and the intact frames.
EXACT: dict[str, tuple[float, Callable[[Truth, Frames], NDArray[Any]]]] = {
    "projector-curve": (1.4, lambda truth, still: emitting(truth, GREY.stack**1.4)),
    "crosstalk": (0.3, lambda truth, still: emitting(truth, dimmed(GREY.stack))),
    "previous": (0.2, lagging),
    "torn": (0.25, torn),
    "dynamic-contrast": (
        0.4, lambda truth, still: still * (1 + 0.4 * (GREY.means - 0.5))[:, None, None]
    ),
    "ambient": (0.05, lambda truth, still: still + ramp(0.05)),
    "exposure": (0.3, lambda truth, still: still * (1 + 0.3 * LATE)),
    "camera-curve": (1.5, lambda truth, still: still ** (1 / 1.5)),
}  # fmt: skip


@pytest.mark.parametrize("name", EXACT)
def test_faults_without_chance_are_exactly_what_they_say(name: str, truth: Truth) -> None:
    amount, expected = EXACT[name]
    still = taken(truth)
    frames = taken(truth, faults={name: amount})
    assert np.abs(frames - still).max() > 0.01 * still.max()
    np.testing.assert_allclose(frames, expected(truth, still), rtol=2e-4, atol=1e-6)


def test_gain_varies_the_light_of_frames_about_its_mean(truth: Truth) -> None:
    still = taken(truth, ambient=0.1)
    room = taken(truth, ambient=0.1) - taken(truth)
    gains = (taken(truth, ambient=0.1, faults={"gain": 0.05}) - room) / (still - room)
    each = gains.mean(axis=(1, 2))
    np.testing.assert_allclose(gains, np.broadcast_to(each[:, None, None], gains.shape), rtol=1e-3)
    assert each.mean() == pytest.approx(1, abs=1e-3)
    assert 0.02 < each.std() < 0.09


def test_rows_hold_a_wave_of_the_stated_amplitude(truth: Truth) -> None:
    wave = taken(truth, faults={"rows": 0.1}) / taken(truth) - 1
    np.testing.assert_allclose(wave - wave[:, :, :1], 0, atol=1e-4)
    assert 0.08 < np.abs(wave).max() <= 0.1001
    assert np.std(wave[:, 0, 0]) > 0.03, "each frame has a phase of its own"


@pytest.mark.parametrize(("name", "deviation"), [("shake", 0.3), ("creep", 0.3 / np.sqrt(24))])
def test_the_camera_moves_about_its_mean_place(name: str, deviation: float) -> None:
    # Every camera pixel sees the one projector pixel with a gain that a spline follows exactly.
    rows, cols = np.indices((40, 30))
    gain = np.exp(-((rows - 20.0) ** 2 + (cols - 15.0) ** 2) / 18)
    truth = Truth(
        lm.truth("wall", (1, 1)).matrix[[0] * 1200].multiply(gain.ravel()[:, None]).tocsr(),
        np.zeros(1200, np.float32), (40, 30), (1, 1),
    )  # fmt: skip
    white = lm.ImagePatterns(np.ones((200, 1, 1), np.float32))
    frames = taken(truth, white, faults={name: 0.3})
    weight = frames / frames.sum(axis=(1, 2), keepdims=True)
    places = np.stack([(weight * rows).sum(axis=(1, 2)), (weight * cols).sum(axis=(1, 2))])
    np.testing.assert_allclose(places.mean(axis=1), (20, 15), atol=2e-3)
    np.testing.assert_allclose(places.std(axis=1), deviation, rtol=0.12)


def test_breathing_zooms_about_the_middle(truth: Truth) -> None:
    still = taken(truth)
    moved = np.abs(taken(truth, faults={"breathing": 0.5}) - still).mean(axis=0)
    assert moved[8:12, 7:11].mean() < 0.4 * moved[[0, 0, -1, -1], [0, -1, 0, -1]].mean()


@pytest.mark.parametrize("name", ["sharpening", "camera-sharpening"])
def test_sharpening_raises_the_contrast_and_keeps_the_mean(name: str, truth: Truth) -> None:
    still, sharp = taken(truth), taken(truth, faults={name: 0.5})
    assert sharp.mean() == pytest.approx(still.mean(), rel=0.05)
    across = np.abs(np.diff(sharp, axis=2)).mean() / np.abs(np.diff(still, axis=2)).mean()
    assert across > 1.05


def test_tone_mapping_brightens_what_is_dark_around(truth: Truth) -> None:
    still = taken(truth)
    gain = (taken(truth, faults={"tone-mapping": 0.3}) / still).mean(axis=0)
    light = still.mean(axis=0)
    assert (
        gain[light < np.quantile(light, 0.2)].mean() > gain[light > np.quantile(light, 0.8)].mean()
    )


def test_the_black_frame_alone_has_another_exposure(truth: Truth) -> None:
    given: dict[str, Any] = {"ambient": 0.2, "bits": 16, "noise": 0}
    good = lm.simulate(truth, GREY, **given)
    wrong = lm.simulate(truth, GREY, faults={"black": 0.5}, **given)
    assert good.decoder.black_frame is not None
    assert wrong.decoder.black_frame is not None
    np.testing.assert_allclose(
        wrong.decoder.black_frame.astype(float), 1.5 * good.decoder.black_frame, atol=1
    )
    np.testing.assert_array_equal(wrong.frame(3), good.frame(3))
    assert wrong.decoder.black_exposure == good.decoder.black_exposure
    with pytest.raises(lm.InputError, match="without a black frame"):
        lm.simulate(truth, GREY, faults={"black": 0.5})


def test_every_fault_changes_frames_and_is_the_same_again(truth: Truth) -> None:
    still = taken(truth, ambient=0.1)
    for name, fault in FAULTS.items():
        if name == "black":
            continue
        given = {name: 1.3 if fault.least > 0 else 0.2}
        frames = taken(truth, ambient=0.1, faults=given)
        assert not np.allclose(frames, still, rtol=1e-3), name
        np.testing.assert_array_equal(frames, taken(truth, ambient=0.1, faults=given))


def test_a_colour_projector_has_crosstalk_within_each_primary(truth: Truth) -> None:
    grey = lm.ColourPatterns(BLACK_AND_WHITE, BLACK_AND_WHITE, BLACK_AND_WHITE)
    colours = taken(truth, grey, faults={"crosstalk": 0.3}) / taken(truth, grey)
    alone = taken(truth, BLACK_AND_WHITE, faults={"crosstalk": 0.3}) / taken(truth, BLACK_AND_WHITE)
    np.testing.assert_allclose(colours[..., 1], alone, rtol=1e-3)


def test_the_command_makes_the_same_and_info_says_it(
    truth: Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth.save(tmp_path / "T.npz")
    lm.write_patterns(tmp_path / "patterns", BLACK_AND_WHITE)
    words = f"simulate {tmp_path}/T.npz --patterns {tmp_path}/patterns -o {tmp_path}/capture"
    assert main([*words.split(), "--fault", "shake=0.1", "--fault", "gain=0.05"]) == 0
    made = lm.simulate(truth, BLACK_AND_WHITE, faults={"gain": 0.05, "shake": 0.1})
    read = lm.Capture.open(tmp_path / "capture")
    assert read.digest == made.digest
    assert read.description["faults"] == {"gain": 0.05, "shake": 0.1}
    capsys.readouterr()
    assert main(["info", f"{tmp_path}/capture"]) == 0
    assert "gain 0.05, shake 0.1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("fault", "advice"),
    [
        ("shaking=1", "use one of projector-curve, .* shake, .* black"),
        ("shake", "write NAME=AMOUNT"),
        ("shake=much", "write NAME=AMOUNT"),
        ("shake=-1", "standard deviation, in camera pixels"),
        ("camera-curve=0", "from 0.1 to 10"),
    ],
)
def test_wrong_faults_are_refused(
    fault: str, advice: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lm.write_patterns(tmp_path / "patterns", lm.BernoulliPatterns((64, 64), 2))
    words = f"simulate wall --patterns {tmp_path}/patterns -o {tmp_path}/capture --fault {fault}"
    assert main(words.split()) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(advice, said), said


def test_the_help_lists_all_faults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--help-all"]) == 0
    # Names may be parted at the end of a line.
    shown = re.sub(r"-\s+", "-", capsys.readouterr().out)
    words = set(re.findall(r"[a-z]+(?:-[a-z]+)*", shown))
    assert set(FAULTS) <= words
