"""Bad captures on the command line: one clear message, exit code 2, nothing half-written.

`tests/faults` tries damaged files and odd arguments. Here the files are sound but do not fit
together, and the tests check the words that the user reads. `tests/check` has the other faults of
frames and patterns.
"""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.cli import main
from lightmatrix.files.images import write_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.transport import store
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.npz import export
from tests.helpers.surface import CAMERA, PROJECTOR, surface

COUNT = 48
ESTIMATE = "estimate --patterns patterns --images images -o scene.zarr"


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with patterns/, images/, a capture/ and a matrix, all good."""
    folder = tmp_path_factory.mktemp("good")
    patterns, sensor = BernoulliPatterns(PROJECTOR, COUNT), Sensor(read_noise=0.003)
    raw = sensor.expose(patterns.forward(surface()))
    write_capture(folder / "capture", patterns, raw.T.reshape(COUNT, *CAMERA), sensor=sensor)
    shutil.copytree(folder / "capture" / "patterns", folder / "patterns")
    (folder / "patterns" / "patterns.json").unlink()
    shutil.copytree(folder / "capture" / "images", folder / "images")
    rows = int(np.prod(CAMERA))
    empty = LightTransport(
        csr_array((rows, int(np.prod(PROJECTOR))), dtype=np.float32),
        np.ones((rows, 1), np.float32),
        CAMERA,
        PROJECTOR,
    )
    store.save(folder / "T.zarr", empty)
    export(folder / "T.npz", empty)
    ProceduralScene((4, 4), (4, 4)).truth().save(folder / "other.npz")
    return folder


Fault = Callable[[Path], None]


def image(k: int) -> str:
    return f"images/image_{k:04d}.png"


def swap(a: int, b: int) -> Fault:
    def fault(folder: Path) -> None:
        first, second, other = folder / image(a), folder / image(b), folder / "images" / "x"
        first.rename(other)
        second.rename(first)
        other.rename(second)

    return fault


def resize(name: str) -> Fault:
    return lambda folder: write_image(folder / name, np.zeros((4, 4), np.uint8), overwrite=True)


def colour_pattern(folder: Path) -> None:
    file = folder / "patterns" / "pattern_0003.png"
    pixels = np.zeros((*PROJECTOR, 3), np.uint8)
    pixels[..., 0] = 255
    write_image(file, pixels, overwrite=True)


def tag_srgb(folder: Path) -> None:
    chunk = b"sRGB\0"
    crc = struct.pack(">I", zlib.crc32(chunk))
    file = folder / image(0)
    data = file.read_bytes()
    file.write_bytes(data[:33] + struct.pack(">I", 1) + chunk + crc + data[33:])


def nothing(folder: Path) -> None:
    """The fault is in the command."""


FAULTS: dict[str, tuple[Fault, str, str]] = {
    # ---- the images of a capture
    "two images swapped": (swap(7, 30), ESTIMATE, "image_0007.png and image_0030.png look swapped"),
    "images of two sizes": (resize(image(9)), ESTIMATE, "is 4 x 4, but image_0000.png is 18 x 22"),
    # ---- its patterns
    "projector binned to 1 x 1": (
        nothing,
        f"{ESTIMATE} --bin-projector 100",
        "the projector has 1 x 1 pixels",
    ),
    "a coloured pattern": (
        colour_pattern,
        ESTIMATE,
        "pattern_0003.png: is 16 x 20 with 3 channels, but pattern_0000.png is 16 x 20",
    ),
    # ---- how they are to be read
    "black frame of another size": (
        resize("black.png"),
        f"{ESTIMATE} --black black.png",
        "black.png: the black frame has shape (4, 4), the images (18, 22)",
    ),
    # ---- capture folders
    "capture without images": (
        lambda folder: shutil.rmtree(folder / "capture" / "images"),
        "estimate capture -o scene.zarr",
        "capture: has no folder images/",
    ),
    "no source": (nothing, "estimate -o scene.zarr", "no capture is given"),
    "no patterns": (nothing, "estimate --images images", "--patterns is missing"),
    "no photographs": (nothing, "estimate --patterns patterns", "--images is missing"),
    # ---- outputs
    "output of the wrong kind": (nothing, "estimate capture -o scene.h5", "ends in .h5"),
    # ---- matrices
    "relight to an unknown format": (
        nothing,
        "relight T.zarr patterns/pattern_0000.png -o out.gif",
        "ends in .gif",
    ),
    "a truth without its background": (
        nothing,
        "evaluate T.zarr --truth T.npz",
        "T.npz holds its background separately",
    ),
    "a truth of another rig": (nothing, "evaluate T.zarr --truth other.npz", "T.zarr is 396 x 320"),
}


def snapshot(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b"folder"
        for path in folder.rglob("*")
    }


def test_a_missing_input_is_named_before_an_output_that_exists(
    good: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(good)
    assert main(["estimate", "nothing", "-o", "T.zarr"]) == 2
    assert "nothing: no such folder" in capsys.readouterr().err
    assert main(["estimate", "capture", "-o", "T.zarr"]) == 2
    assert "T.zarr: exists already" in capsys.readouterr().err


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_gives_one_message_and_leaves_nothing(
    fault: str,
    good: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "work"
    shutil.copytree(good, folder)
    put, command, message = FAULTS[fault]
    put(folder)
    before = snapshot(folder)
    monkeypatch.chdir(folder)
    code = main(command.split())
    shown = capsys.readouterr()
    assert message in shown.err
    assert code == 2
    assert "Traceback" not in shown.err
    assert shown.out == ""
    assert shown.err.count("error:") == 1
    assert snapshot(folder) == before


@pytest.mark.usefixtures("unchecked")
def test_suspicious_input_is_used_with_a_warning(
    good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "work"
    shutil.copytree(good, folder)
    tag_srgb(folder)
    monkeypatch.chdir(folder)
    assert main(f"{ESTIMATE} --iterations 2 --bin-camera 4".split()) == 0
    assert "image_0000.png: tagged sRGB" in capsys.readouterr().err
    assert (
        main(f"{ESTIMATE} --iterations 2 --bin-camera 4 --response srgb --overwrite".split()) == 0
    )
    assert "sRGB" not in capsys.readouterr().err
