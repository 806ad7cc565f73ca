"""The command line as its users and scripts see it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from scipy.sparse import load_npz

import lightmatrix
from lightmatrix.cli import main
from lightmatrix.cli.app import app
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.transport import store

pytestmark = pytest.mark.usefixtures("unchecked")
COMMANDS: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the main commands have been run once."""
    folder = tmp_path_factory.mktemp("work")
    ProceduralScene((8, 9), (8, 8), background=0).truth().save(folder / "T.npz")
    run = [
        "patterns bernoulli -k 48 --size 8x8 -o patterns",
        "simulate T.npz --patterns patterns --exposure 1.2 -o capture",
        "estimate capture -o scene.zarr --regularization 0.05",
    ]
    for line in run:
        assert main(_placed(line, folder)) == 0
    return folder


def _placed(line: str, folder: Path) -> list[str]:
    files = ("T.npz", "patterns", "capture", "scene.zarr", "out.png", "X.npz", "X.mat", "P.png")
    words = line.split()
    return [str(folder / w) if w in files and i > 0 else w for i, w in enumerate(words)]


def _json(line: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert main([*_placed(line, folder), "--json"]) == 0
    result: dict[str, object] = json.loads(capsys.readouterr().out)
    return result


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-o out.png", "Missing argument 'VIEW'"),
        ("around -o out.png", "there is no view 'around'"),
        ("row 3 -o out.png", "the view row with the index 3"),
        ("row 3,-1 -o out.png", "a pixel of 3,-1\n  write row,column"),
        ("row 3,99 -o out.png", "there is no camera sample 3, 99"),
        ("column 1,2,3 -o out.png", "the view column with the index 1, 2, 3"),
        ("correspondence -o out.npy", "a correspondence in"),
        ("depth -o out.png", "the view depth without a geometry"),
        ("gap --geometry rig.json -o out.png", "the view gap with a geometry"),
        ("gap -o out.jpg", "the name of the output ends in .jpg"),
    ],
)
def test_show_refuses(
    words: str, message: str, work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["show", str(work / "scene.zarr"), *words.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_estimate_row_by_row_has_no_footprints(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, out = str(tmp_path / "plain.zarr"), tmp_path / "out.png"
    assert main(["estimate", str(work / "capture"), "--no-coherent", "-o", plain]) == 0
    assert main(["show", plain, "footprint", "-o", str(out)]) == 2
    assert "this matrix has no footprint of its rows" in capsys.readouterr().err
    assert not out.exists()
    assert main(["show", str(work / "scene.zarr"), "footprint", "-o", str(out)]) == 0


def test_overwrite_replaces_only_numbers_of_a_picture(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, numbers = str(work / "scene.zarr"), str(tmp_path / "map.npz")
    words = ["show", scene, "correspondence", "-o", numbers, "--overwrite"]
    assert main(words) == 0
    assert main(words) == 0
    np.savez(numbers, mine=np.zeros(3))
    assert main(words) == 2
    assert "was not written by lightmatrix" in capsys.readouterr().err
    assert list(np.load(numbers)) == ["mine"]


def test_lights_one_at_a_time_are_estimated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Photographs that determine T are read directly, and no row of theirs converges."""
    assert main(["patterns", "onepixel", "--size", "4x6", "-o", str(tmp_path / "lights")]) == 0
    seen = np.random.default_rng(0).integers(0, 200, (24, 16, 16)).astype(np.uint8)
    np.save(tmp_path / "seen.npy", seen)
    words = ["--patterns", str(tmp_path / "lights"), "--images", str(tmp_path / "seen.npy")]
    assert main(["estimate", *words, "-o", str(tmp_path / "T.zarr")]) == 0
    assert "direct" in capsys.readouterr().out


def test_info_has_labels_instead_of_keys(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(_placed("info scene.zarr --verbose", work)) == 0
    shown = capsys.readouterr().out
    assert "duality gap (largest)" in shown
    assert "rows half clipped or more" in shown
    assert "_" not in shown.replace(str(work), "")


def test_export(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _json("export scene.zarr X.npz", work, capsys)
    assert load_npz(work / "X.npz").shape == (72, 64)
    _json("export scene.zarr X.mat", work, capsys)
    left_out = _json("info scene.zarr", work, capsys)["background_share"]
    assert main(_placed("export scene.zarr X.npz --overwrite", work)) == 0
    note = f"without the background ({100 * float(str(left_out)):.1f} % of the light)"
    assert note in capsys.readouterr().out
    assert main(_placed("export scene.zarr X.npz --overwrite --dense-background", work)) == 0
    assert "without" not in capsys.readouterr().out
    whole = load_npz(work / "X.npz")
    relit = store.open(work / "scene.zarr").relight(np.ones((8, 8), np.float32))
    np.testing.assert_allclose(whole @ np.ones(64), relit.ravel(), rtol=1e-4, atol=1e-6)
    assert (work / "X.mat").stat().st_size > 0


def test_rare_options_are_shown_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["estimate", "--help"]) == 0
    short = capsys.readouterr().out
    assert main(["estimate", "--help-all"]) == 0
    long = capsys.readouterr().out
    for option in ("--patterns", "--black", "--report", "--bin-camera"):
        assert f"{option} " in short
    for option in ("--solver", "--tile-rows", "--mosaic", "--cluster"):
        assert option not in short
        assert option in long
    assert "lightmatrix estimate --help-all" in short
    # Types of Python are not what a reader writes.
    assert not re.search("<(int|str|path|list)|x>=", long)


def test_every_command_has_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    overview = capsys.readouterr().out
    assert "..." not in overview.replace("[ARGS]...", "")
    assert {"patterns", "simulate", "estimate", "plan", "demo"} <= set(COMMANDS)
    for command in COMMANDS:
        assert re.search(rf"^ *{command} ", overview, re.MULTILINE)
        assert main([command, "--help-all"]) == 0
        text = capsys.readouterr().out
        assert text.startswith(f"Usage: lightmatrix {command}")
        # Types of Python are no words of a reader.
        assert not re.search(r"<\w|\bTEXT\b|\bInt\b", text)


def test_the_installed_command_runs_without_a_terminal() -> None:
    command = Path(sys.executable).with_name("lightmatrix")
    for words in ([command], [sys.executable, "-m", "lightmatrix"]):
        result = subprocess.run([*words, "--version"], capture_output=True, text=True, check=True)
        assert result.stdout == f"lightmatrix {lightmatrix.__version__}\n"
        assert result.stderr == ""


def test_usage_errors_end_with_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["estimate", "--no-such-option"]) == 2
    assert "see `lightmatrix estimate --help-all`" in capsys.readouterr().err
    assert main(["patterns", "bernouli", "-o", "x"]) == 2
    shown = capsys.readouterr().err
    assert "Traceback" not in shown
    assert "Value error" not in shown
    assert "did you mean bernoulli? see `lightmatrix patterns --help-all`" in shown
    # What is required is in the short help.
    for words in ("rig", "plan"):
        assert main([words]) == 2
        shown = capsys.readouterr().err
        assert shown.startswith("error: Missing ")
        assert f"see `lightmatrix {words} --help`" in shown
    assert main(["patrns"]) == 2
    assert "see `lightmatrix --help`" in capsys.readouterr().err
