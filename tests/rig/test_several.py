"""Several projectors at once, several cameras in turn: from photographs to the wall."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import imagecodecs
import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.rig.devices.base import Projector
from lightmatrix.rig.devices.several import SeveralProjectors, stacked
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import SimulatedCapture
from lightmatrix.simulation.truth import Truth, binned
from lightmatrix.transport.matrix import LightTransport
from tests.helpers.projectors import two_projectors

pytestmark = pytest.mark.usefixtures("small_scenes")


@pytest.fixture(scope="module")
def both() -> Truth:
    return two_projectors(binned(library.truth("l_objects"), 2))


@pytest.fixture(scope="module")
def capture(both: Truth) -> SimulatedCapture:
    return lm.simulate(both, lm.BernoulliPatterns((64, 32), 24), exposure=0.3)


@pytest.fixture(scope="module")
def stores(capture: SimulatedCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stores")
    capture.save(folder / "capture")
    lm.estimate(folder / "capture", output=folder / "scene", check=False, correct="none")
    return folder


def _error(found: LightTransport, both: Truth) -> list[float]:
    pairs = zip(found.split(), both.transport().split(), strict=True)
    return [relative_error(one, known) for one, known in pairs]


def test_each_projector_is_estimated_as_well_as_alone(
    both: Truth, capture: SimulatedCapture, stores: Path
) -> None:
    """Though the second one hangs upside down, so that its light moves the other way."""
    alone = []
    for known in both.transport().split():
        truth = Truth(known.sparse, known.sparse.data, known.camera_shape, known.projector_shape)
        photographs = lm.simulate(truth, lm.BernoulliPatterns((32, 32), 24), exposure=0.3)
        found = lm.estimate(photographs, check=False, correct="none")
        alone.append(relative_error(found, known))
    joint = [lm.open(stores / "scene" / f"projector-{k}.zarr") for k in (1, 2)]
    errors = [lm.evaluate(one, capture.truth).relative_error for one in joint]
    assert max(np.divide(errors, alone)) < 1.4
    # As one projector, all of whose light moves alike, they err several times as much.
    as_one = lm.estimate(replace(capture, projectors=()), check=False, correct="none")
    as_one = replace(as_one, provenance=both.metadata)
    assert min(np.divide(_error(as_one, both), errors)) > 2


def test_the_parts_of_t_add_up(both: Truth, capture: SimulatedCapture) -> None:
    """Also its background, and where one projector is smaller than the other."""
    sizes = ((32, 32), (24, 20))
    found = lm.estimate(capture, check=False, correct="none")
    assert found.background.any()
    whole = replace(found, provenance={"projectors": sizes})
    shown = np.random.default_rng(0).random((2, 32, 32), np.float32)
    shown[1, 24:] = shown[1, :, 20:] = 0
    parts = [
        one.relight(shown[k][: size[0], : size[1]])
        for k, (one, size) in enumerate(zip(whole.split(), sizes, strict=True))
    ]
    expected = found.relight(shown.reshape(64, 32))
    np.testing.assert_allclose(sum(parts), expected, atol=0.02 * expected.max())
    whole = replace(found, provenance=both.metadata)
    parts = [one.relight(pattern) for one, pattern in zip(whole.split(), shown, strict=True)]
    np.testing.assert_allclose(sum(parts), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("command", "hint"),
    [
        *((f"{use} scene", "scene/projector-1.zarr, scene/projector-2.zarr") for use in (
            "info", "evaluate --truth capture/truth.npz",
            "separate -o x", "triangulate --geometry g.json -o x.ply",
        )),
        ("view scene", "scene/projector-1.zarr"),
        ("relight scene p.png -o x.png", "scene/projector-1.zarr"),
        ("show scene correspondence -o x.png", "scene/projector-1.zarr"),
        ("map scene -o x.exr", "end it in .mpcdi, or map the store of each projector"),
        *((f"{use} cameras", "cameras/camera-1, cameras/camera-2") for use in (
            "estimate -o x", "check", "track -o x.zarr", "info", "decode -o x.npz",
        )),
    ],
)  # fmt: skip
def test_hints_name_what_a_folder_holds(
    command: str, hint: str, stores: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("scene").symlink_to(stores / "scene")
    for k in (1, 2):
        Path(f"cameras/camera-{k}").mkdir(parents=True)
    lm.write_image("p.png", np.ones((32, 32)))
    assert main(command.split()) == 2
    assert hint in capsys.readouterr().err


def test_an_estimate_that_was_stopped_goes_on(
    capture: SimulatedCapture, stores: Path, tmp_path: Path
) -> None:
    """Of several projectors too, whose folder others must not write meanwhile."""
    done: list[int] = []

    def estimate(most: int) -> None:
        def stop(rows: int, _: int) -> None:
            done.append(rows)
            assert (tmp_path / ".scene.lock").exists()
            if rows >= most:
                raise KeyboardInterrupt

        lm.estimate(
            capture, output=tmp_path / "scene", tile_rows=256, check=False, correct="none",
            coherent=False, progress=stop,
        )  # fmt: skip

    with pytest.raises(KeyboardInterrupt):
        estimate(512)
    assert (tmp_path / "scene.partial").is_dir()
    done.clear()
    estimate(10**9)
    assert done[0] >= 512
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene"]
    parts = [lm.open(tmp_path / "scene" / f"projector-{k}.zarr") for k in (1, 2)]
    assert [one.projector_shape for one in parts] == [(32, 32), (32, 32)]


def test_patterns_of_one_projector_are_not_halved_for_two() -> None:
    with pytest.raises(InputError, match="64 x 64 for 2 projectors") as caught:
        lm.simulate("stage", lm.BernoulliPatterns((64, 64), 8))
    assert "128x64 for 2 of 64x64" in str(caught.value.hint)


def test_devices_of_several_projectors() -> None:
    """All are closed though one fails; a grey picture beside one in colour is shown in grey."""
    closed = []

    class Lamp(Projector):
        def __init__(self, number: int) -> None:
            self._shape, self.number = (2, 3), number

        def info(self) -> dict[str, Any]:
            return {"name": "lamp"}

        def show(self, image: NDArray[np.uint8]) -> float:
            return 0.0

        def close(self) -> None:
            closed.append(self.number)
            raise lm.DeviceError("lost", hint="none")

    with pytest.raises(lm.DeviceError):
        SeveralProjectors([Lamp(1), Lamp(2)]).close()
    assert sorted(closed) == [1, 2]
    pictures = [np.full((2, 3), 0.5), np.ones((2, 3, 3))]
    for shown in (pictures, pictures[::-1]):
        assert stacked(shown, [(2, 3)] * 2).sum() == 3 * 6 * 1.5
    with pytest.raises(InputError, match="no projector"):
        lm.open_projector([])


def test_white_is_even_where_both_shine(both: Truth, stores: Path) -> None:
    """By the folder that `estimate` wrote, in a photograph by the true T."""
    found = lm.compensate(stores / "scene", np.ones((32, 32)), brightness=0.4)

    def uneven(patterns: Sequence[NDArray[np.floating]]) -> float:
        parts = zip(both.transport().split(), patterns, strict=True)
        seen = np.sum([one.relight(shown) for one, shown in parts], axis=0)[found.reachable]
        return float(seen.std() / seen.mean())

    assert found.reachable.mean() > 0.7
    # Compensation by the true T misses 0.013.
    assert uneven(found.patterns) < 0.035
    assert uneven([np.ones((32, 32))] * 2) > 0.2


def test_a_media_server_blends_them(both: Truth, stores: Path) -> None:
    """One MPCDI file has a region and a mask for each; white through the masks is even."""
    lm.map_projectors(stores / "scene", output=stores / "wall.mpcdi")
    with zipfile.ZipFile(stores / "wall.mpcdi") as archive:
        root = ElementTree.fromstring(archive.read("mpcdi.xml"))
        regions = [region.attrib["id"] for region in root.iterfind("display/buffer/region")]
        assert regions == [part.attrib["region"] for part in root.iterfind("files/fileset")]
        assert len(set(regions)) == 2
        alphas = [
            imagecodecs.png_decode(archive.read(str(part.findtext("alphaMap/path")))) / 65535
            for part in root.iterfind("files/fileset")
        ]
        for part in root.iterfind("files/fileset"):
            assert part.findtext("geometryWarpFile/path") in archive.namelist()
    parts = zip(both.transport().split(), alphas, strict=True)
    masked = np.sum([one.relight(alpha) for one, alpha in parts], axis=0)
    plain = np.sum([one.relight(np.ones((32, 32))) for one in both.transport().split()], axis=0)
    lit = plain > 0.3 * np.median(plain)
    assert masked[lit].std() / masked[lit].mean() < 0.5 * plain[lit].std() / plain[lit].mean()


def test_a_capture_names_its_projectors(capture: SimulatedCapture, stores: Path) -> None:
    opened = lm.Capture.open(stores / "capture")
    assert opened.projectors == ((32, 32), (32, 32))
    with pytest.raises(InputError, match="do not bin"):
        opened.bin(projector=2)
    with pytest.raises(InputError, match="all projectors, one above the other"):
        replace(opened, projectors=((32, 32), (30, 30), (30, 30)))
    lm.pack(stores / "capture", stores / "packed")
    assert lm.Capture.open(stores / "packed").projectors == opened.projectors
    file = stores / "packed" / "capture.json"
    for wrong in (3, [[64, 32]], [[32, 32], [32]], [[32, 32], [0, 32]]):
        content = json.loads(file.read_text())
        file.write_text(json.dumps({**content, "projectors": wrong}))
        with pytest.raises(InputError, match='"projectors" cannot be'):
            lm.Capture.open(stores / "packed")


@pytest.mark.usefixtures("unchecked")
def test_a_studio(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two projectors and two cameras, from the capture to the wall, by commands."""
    monkeypatch.chdir(tmp_path)
    rig = "virtual:stage,size=16,real=0"
    capture = ["capture", "--rig", rig, "-k", "24", "-o", "wall", "--estimate", "scene", "--json"]
    assert main(capture) == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["frames"] for one in said["cameras"]] == [24, 24]
    assert [path.name for path in sorted(Path("scene/camera-2").iterdir())] == [
        ".lightmatrix",
        "projector-1.zarr",
        "projector-2.zarr",
    ]
    assert main(capture) == 2
    # A run that was stopped before the second camera goes on there, with the same settings.
    shutil.rmtree("wall/camera-2")
    shutil.rmtree("scene/camera-2")
    capsys.readouterr()
    assert main([*capture, "-k", "25"]) == 2
    assert "camera-1: was captured otherwise (patterns was 24, is 25)" in capsys.readouterr().err
    before = Path("scene/camera-1/projector-1.zarr/zarr.json").stat().st_mtime_ns
    assert main(capture) == 0
    assert [one["frames"] for one in json.loads(capsys.readouterr().out)["cameras"]] == [24, 24]
    assert Path("scene/camera-1/projector-1.zarr/zarr.json").stat().st_mtime_ns == before
    assert Path("scene/camera-2/projector-2.zarr").is_dir()
    lm.write_image("picture.png", np.tile(np.linspace(0.2, 0.8, 16), (16, 1)))
    with_rig = ["--rig", rig, "--rig-file", "rig-1.json"]
    assert main(["compensate", "scene/camera-1", "picture.png", "-o", "show.png"]) == 0
    assert "show-1.png and show-2.png: wanted white" in capsys.readouterr().out
    assert main(["project", "show-1.png", "show-2.png", *with_rig, "-o", "seen.png"]) == 0
    for shown in ("show-1.png", "."):
        assert main(["project", shown, *with_rig, "-o", "half.png"]) == 2
        assert "one picture for each projector" in capsys.readouterr().err
    other = ["--rig", rig, "--rig-file", "other.json"]
    assert main(["project", "show-1.png", "show-2.png", *other, "-o", "again.png"]) == 0
    assert "other.json: no such file; the rig is measured" in capsys.readouterr().err
    lost = ["-o", "lost.png", "--rig-file", "lost.json"]
    assert main(["compensate", "scene/camera-1", "picture.png", *lost]) == 2
    assert "lost.json: no such file" in capsys.readouterr().err
    assert main(["map", "scene/camera-1", "-o", "wall.mpcdi"]) == 0
    assert " and " in capsys.readouterr().out
    assert main(["map", "scene/camera-1", "-o", "wall.npz", "--reverse"]) == 2
    assert main(["compensate", "scene/camera-1", "picture.png", "-o", "b.png", *with_rig]) == 0
    capsys.readouterr()
    assert main(["project", "show-1.png", "show-2.png", "seen.png", *with_rig, "-o", "c.png"]) == 2
    assert "one picture for each projector" in capsys.readouterr().err
