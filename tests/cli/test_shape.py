"""`decode`, `triangulate` and `check` of stripes on the command line: what the user reads."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import lightmatrix as lm
from lightmatrix.cli import main


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures of `corner` under stripes and under random patterns, and what stripes decode to."""
    folder = tmp_path_factory.mktemp("made")
    code = lm.make_patterns("graycode", (64, 64), inverse=True)
    for name, patterns in (("striped", code), ("random", lm.BernoulliPatterns((64, 64), 16))):
        lm.simulate("corner", patterns, exposure=0.3).save(folder / name)
    lm.decode(folder / "striped", output=folder / "c.npz")
    return folder


@pytest.fixture(autouse=True)
def _inside(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)


GEOMETRY = "--geometry striped/geometry.json -o new.ply"


@pytest.mark.parametrize(
    ("line", "message", "hint"),
    [
        (f"triangulate striped {GEOMETRY}", "under stripes", "lightmatrix decode striped"),
        (f"triangulate random {GEOMETRY}", "no.* matrix|not a light", "estimate random"),
        ("calibrate striped --focal 128 -o g.json", "under stripes", "lightmatrix decode striped"),
        ("decode striped stripes", "what is stripes", "give striped alone.* -o"),
        ("triangulate c.npz -o new.ply", "'--geometry'", "calibrate.*simulate.*geometry.json"),
        ("triangulate c.npz --geometry c.npz -o new.ply", "no geometry of a rig", "calibrate"),
        ("triangulate c.npz --geometry striped/depth.tiff -o new.ply", "no geometry", "calibrate"),
        (f"triangulate c.npz {GEOMETRY} --depth new.png", "unit of .* 'scene unit'", r"\.tif"),
        (
            "decode striped/patterns striped/images --response striped -o new.npz",
            "response of 'striped', which is a folder",
            "capture.json",
        ),
    ],
)
def test_what_is_wrong_and_what_would_work(
    line: str, message: str, hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert re.search(message, said[0])
    assert re.search(hint, " ".join(said[1:]))
    assert not list(Path().glob("new.*"))


def test_the_capture_of_a_simulation_is_a_geometry() -> None:
    for name in ("striped", "striped/geometry.json"):
        line = f"triangulate c.npz --geometry {name} -o {name.partition('/')[2]}cloud.ply"
        assert main(line.split()) == 0
    assert Path("cloud.ply").read_bytes() == Path("geometry.jsoncloud.ply").read_bytes()


def test_two_exchanged_photographs_give_no_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Under the inverse of the coarsest stripe, the projector is mirrored: all points are wrong."""
    shutil.copytree("striped", tmp_path / "mixed")
    one, two = sorted((tmp_path / "mixed" / "images").iterdir())[:2]
    content = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(content)
    assert main(f"decode {tmp_path}/mixed -o {tmp_path}/c.npz".split()) == 0
    assert "warning: mirrored" in capsys.readouterr().err
    assert main(f"triangulate {tmp_path}/c.npz {GEOMETRY}".split()) == 2
    said = capsys.readouterr().err
    assert re.search(r"error: the geometry does not fit: .* light 18 projector pixels off", said)
    assert "in order, and neither mirrored nor turned" in said


def test_a_note_is_one_line_after_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", "striped"]) == 0
    fine = capsys.readouterr().out.splitlines()
    assert [fine[0], fine[1][:13], len(fine)] == ["nothing is wrong", "note: stripes", 2]
    shutil.copytree("striped", tmp_path / "mixed")
    images = sorted((tmp_path / "mixed" / "images").iterdir())
    images[4].write_bytes(images[12].read_bytes())
    assert main(["check", str(tmp_path / "mixed")]) == 1
    spoilt = capsys.readouterr().out.splitlines()
    assert "image_0004.png" in spoilt[0]
    assert [line.startswith("note: ") for line in spoilt] == [False] * (len(spoilt) - 1) + [True]
    assert lm.check(tmp_path / "mixed")[-1].is_note
