"""`lm.estimate` and `lightmatrix estimate` warn of the same, and refuse the same."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture.folder import write_capture
from lightmatrix.cli import main
from lightmatrix.cli.terminal import as_options
from lightmatrix.errors import LightMatrixError
from lightmatrix.files.images import decode_image, encode_image
from tests.helpers.surface import PROJECTOR, photographs

PATTERNS = lm.BernoulliPatterns(PROJECTOR, 32)
BEAT = 1 + 0.05 * np.sin(1 + 1.3 * np.arange(32))
LIGHT = photographs(PATTERNS, noise=0.001)
# The surface is too smooth and small for JPEG to leave traces.
SCENE = lm.simulate("l_objects", lm.BernoulliPatterns((64, 64), 32), exposure=0.5, bits=8)
CODED = [encode_image(SCENE.frames.read(k), "jpeg", quality=60) for k in range(32)]
# The faults of benchmarks/frame_checks.py: photographs and the kind of finding that names them.
# Wrong orders and numbers are refused.
FAULTY = {
    "two frames swapped": ("order", LIGHT[np.r_[:3, 9, 4:9, 3, 10:32]]),
    "one frame dropped": ("31 images", LIGHT),
    "one dropped, the last twice": ("order", LIGHT[np.r_[:9, 10:32, 31]]),
    "black": ("frame", np.where(np.arange(32)[:, None, None] == 9, 0, LIGHT).astype(np.uint8)),
    "gamma": ("camera-curve", np.rint(255 * (LIGHT / 255) ** (1 / 2.2)).astype(np.uint8)),
    "JPEG": ("jpeg", np.stack([decode_image(each) for each in CODED])),
    "shifted": ("motion", np.concatenate([LIGHT[:16], np.roll(LIGHT[16:], 2, axis=2)])),
    "flicker": ("gain", photographs(PATTERNS, gain=BEAT, noise=0.001)),
}


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


@pytest.mark.parametrize("fault", FAULTY)
def test_the_same_faults_are_named(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, (kind, frames) = tmp_path / "capture", FAULTY[fault]
    patterns = SCENE.patterns if kind == "jpeg" else PATTERNS
    write_capture(folder, patterns, frames, sensor=lm.Sensor(0.9, read_noise=0.001))
    refused = kind in ("order", "31 images")
    if kind == "31 images":
        (folder / "images" / "image_0009.png").unlink()
    said = from_python(folder, coherent=False, iterations=1)
    assert said[0].startswith("error: " if refused else f"warning: {kind}: ")
    words = f"estimate {folder} -o {tmp_path}/scene.zarr --no-coherent --iterations 1"
    assert main(words.split()) == (2 if refused else 0)
    assert capsys.readouterr().err.splitlines() == said
    if not refused:
        found = lm.open(tmp_path / "scene.zarr").provenance["findings"]
        assert [each["kind"] for each in found] == [kind]


def test_a_response_that_is_found_is_named_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report shows photographs as they were read then."""
    folder, output = tmp_path / "capture", tmp_path / "scene.zarr"
    write_capture(folder, PATTERNS, LIGHT, sensor=lm.Sensor(0.9, read_noise=0.001))
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
