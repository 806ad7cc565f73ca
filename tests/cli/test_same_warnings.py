"""`lm.estimate` and `lightmatrix estimate` warn of the same, and refuse the same."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks import frame_checks
from lightmatrix.capture.folder import write_capture
from lightmatrix.check.finding import Finding
from lightmatrix.cli import main
from lightmatrix.cli.terminal import as_options
from lightmatrix.errors import LightMatrixError

# The kind of finding that names each fault of the frame checks; an order is refused.
KINDS = {
    "two frames swapped": "order",
    "one dropped, the last twice": "order",
    "one frame black": "frame",
    "gamma 2.2": "response",
    "JPEG at quality 60": "jpeg",
    "shifted 2 px from the middle on": "motion",
    "flicker of 5 %": "flicker",
}
DRAW = next(each for each in frame_checks.draws(8, 0) if not each.room.any())


def from_python(folder: Path, **settings: object) -> list[str]:
    """What a call warns of, and why it refuses, as the command prints it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            lm.estimate(folder, progress=False, **settings)  # type: ignore[arg-type]
            refused = []
        except LightMatrixError as error:
            refused = [f"error: {error.message}", f"  {error.hint}"]
    assert {each.category for each in caught} <= {lm.LightMatrixWarning}
    said = [f"warning: {each.message}" for each in caught]
    return as_options("\n".join(said + refused)).splitlines()


@pytest.mark.parametrize("fault", KINDS)
def test_the_same_faults_are_named(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[lm.Capture] = []

    def keep(capture: lm.Capture) -> list[Finding]:
        made.append(capture)
        return []

    monkeypatch.setattr(frame_checks, "check_capture", keep)
    frame_checks.FAULTS[fault](DRAW, np.random.default_rng(0))
    frames = [made[0].frame(k) for k in range(made[0].count)]
    folder, sensor = tmp_path / "capture", lm.Sensor(black_level=float(made[0].decoder.black_level))
    write_capture(folder, made[0].patterns, frames, sensor=sensor)
    said = from_python(folder, coherent=False, iterations=1)
    assert any(line.startswith(f"warning: {KINDS[fault]}: ") for line in said) or (
        KINDS[fault] == "order" and said[0].startswith("error: ")
    )
    words = f"estimate {folder} -o {tmp_path}/scene.zarr --no-coherent --iterations 1"
    assert main(words.split()) == (2 if KINDS[fault] == "order" else 0)
    assert capsys.readouterr().err.splitlines() == said


def test_a_response_that_is_found_is_named_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report shows photographs as they were read then."""
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    frames = [capture.frame(k) for k in range(capture.count)]
    folder, output = tmp_path / "capture", tmp_path / "scene.zarr"
    write_capture(folder, capture.patterns, frames, sensor=capture.sensor)
    words = f"estimate {folder} --response auto --no-coherent --iterations 5 -o {output}"
    assert main([*words.split(), "--report", f"{tmp_path}/report"]) == 0
    printed = capsys.readouterr().err.splitlines()
    said = from_python(folder, response="auto", coherent=False, iterations=5)
    assert said == printed
    assert [line.startswith("warning: response: gamma 1.0") for line in said] == [True]
    assert lm.open(output).provenance["found_response"]["gamma"] == pytest.approx(1, abs=0.02)


def test_in_colour_the_same_faults_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    patterns = lm.colour_bernoulli((16, 16), 24, grey=8)
    scene = lm.ProceduralScene((16, 16), (16, 16)).truth()
    capture = lm.simulate(scene, patterns, exposure=20)
    folder = tmp_path / "capture"
    write_capture(
        folder, patterns, [capture.frames.read(k) for k in range(24)], sensor=capture.sensor
    )
    with pytest.warns(lm.LightMatrixWarning, match="light: ") as caught:
        lm.estimate_colour(folder, progress=False)
    assert main(f"estimate {folder} -o {tmp_path}/scene".split()) == 0
    said = "\n".join(f"warning: {each.message}" for each in caught)
    assert capsys.readouterr().err.splitlines() == as_options(said).splitlines()
