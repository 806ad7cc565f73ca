"""Commands that are refused leave nothing, and never replace photographs."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from lightmatrix.cli import main

if sys.platform != "win32":
    pass
from tests.helpers.outputs import snapshot


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with patterns p and a capture cap."""
    folder = tmp_path_factory.mktemp("work")
    patterns = f"patterns bernoulli -k 16 --size 64x64 -o {folder}/p"
    capture = f"simulate l_objects --patterns {folder}/p -o {folder}/cap"
    assert [main(line.split()) for line in (patterns, capture)] == [0, 0]
    return folder


@pytest.mark.parametrize(
    "line",
    [
        "patterns bernoulli -k 0 --size 4x4 -o new/p",
        "patterns hadamard --size 5x5 -o new/p",
        "patterns bernoulli --size 4x4 -o link",
        "patterns bernoulli --size 4x4 -o . --overwrite",
        "simulate l_objects --patterns none -o new/cap",
        "simulate no_scene --patterns p -o new/cap",
        "simulate l_objects --patterns p --exposure dark -o new/cap",
        "estimate none -o new/s.zarr",
        "estimate cap -o new/s.zarr --regularization 0",
        "estimate cap -o new/s.zarr --regularization nan",
        "estimate cap -o new/s.zarr --solver admm --regularization -1",
        "estimate cap -o new/s.zarr --bin-camera 0",
        "estimate cap -o link/s.zarr",
        "export none.zarr new/T.NPZ",
        "relight none.zarr p/pattern_0000.png -o new/out.PNG",
        "render no_scene --size 8x8 -o new/T.NPZ",
    ],
)
def test_refused_commands_leave_nothing(
    line: str,
    work: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(work, tmp_path, dirs_exist_ok=True)
    (tmp_path / "link").symlink_to("nowhere/x")
    before = snapshot(tmp_path)
    assert main(line.split()) == 2
    assert "error: " in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_overwrite_spares_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cap/images").mkdir(parents=True)
    Path("cap/images/photo.png").touch()
    Path("cap/capture.json").write_text(json.dumps({"format": "lightmatrix-capture", "version": 1}))
    before = snapshot(tmp_path)
    assert (
        main(["patterns", "bernoulli", "-k", "2", "--size", "8x8", "-o", "cap", "--overwrite"]) == 2
    )
    assert snapshot(tmp_path) == before
