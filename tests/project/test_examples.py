"""Every example runs and makes its pictures of the gallery."""

from __future__ import annotations

import runpy
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from docs_site import GALLERY, GALLERY_FOLDER, pictures_of

import lightmatrix as lm
from lightmatrix.simulation.truth import binned

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def _run(name: str, out: Path, **estimate: Any) -> Any:
    """Run an example; its pictures must have the sizes of those in the gallery.

    Most simulate an intact rig. Checks of its frames, which take half of the time, find nothing.
    """
    with pytest.MonkeyPatch.context() as patch:
        settings = estimate or {"check": False, "correct": "none"}
        patch.setattr(lm, "estimate", partial(lm.estimate, **settings))
        result = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](out)
    for picture in pictures_of(name):
        kept = ROOT / "docs" / GALLERY_FOLDER / f"{name}-{picture}"
        assert lm.read_image(out / picture).shape == lm.read_image(kept).shape, "make gallery"
    return result


@pytest.fixture(params=[True, pytest.param(False, marks=pytest.mark.slow)], ids=["known", "found"])
def of_t(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an example does with T, which takes a tenth of the estimate: of the known one, too."""
    if request.param:
        monkeypatch.setattr(lm, "estimate", lambda capture, **_: capture.truth.transport())


def test_every_example_is_tested_and_in_the_gallery() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(GALLERY)
    assert all(f"def test_{name}(" in Path(__file__).read_text() for name in GALLERY)
    named = {f"{name}-{picture}" for name in GALLERY for picture in pictures_of(name)}
    assert {path.name for path in (ROOT / "docs" / GALLERY_FOLDER).iterdir()} == named


def test_relight_and_dual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _run("relight_and_dual", tmp_path)
    (tmp_path / "again").mkdir()
    monkeypatch.setattr(sys, "argv", ["relight_and_dual.py", str(tmp_path / "again")])
    runpy.run_path(str(EXAMPLES / "relight_and_dual.py"), run_name="__main__")
    assert {path.name for path in (tmp_path / "again").iterdir()} == {
        "relit.png", "dual.png", "row.png",
    }  # fmt: skip


def test_estimate_in_python(tmp_path: Path) -> None:
    blind, paper, convex = _run("estimate_in_python", tmp_path).values()
    assert max(paper, convex) < 0.5 * blind


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenes of examples at a quarter of their pixels."""
    known = lm.truth
    monkeypatch.setattr(lm, "truth", lambda name: binned(known(name), 2))


@pytest.mark.usefixtures("coarse")
def test_few_patterns(tmp_path: Path) -> None:
    row_by_row, coherent, two_exposures = _run("few_patterns", tmp_path).values()
    assert coherent < 0.6 * row_by_row
    assert two_exposures < 0.02


@pytest.mark.usefixtures("of_t")
def test_correspondence(tmp_path: Path) -> None:
    assert _run("correspondence", tmp_path) > 0.97


def test_self_calibration(tmp_path: Path) -> None:
    assert _run("self_calibration", tmp_path) < 0.003


@pytest.mark.usefixtures("of_t")
def test_direct_and_global(tmp_path: Path) -> None:
    assert 0.05 < _run("direct_and_global", tmp_path) < 0.25


def test_own_photographs(tmp_path: Path) -> None:
    report = _run("own_photographs", tmp_path, check=True)
    # A few rows clip under a single projector pixel, which nothing tells the brightness of.
    assert report["verdict"] in ("good", "fair")
    assert (tmp_path / "report" / "report.html").exists()


@pytest.mark.usefixtures("of_t")
def test_compensation(tmp_path: Path) -> None:
    uncompensated, compensated = _run("compensation", tmp_path)
    assert compensated > uncompensated + 20


@pytest.mark.usefixtures("of_t")
def test_two_projectors(tmp_path: Path) -> None:
    uncompensated, compensated = _run("two_projectors", tmp_path)
    assert compensated > uncompensated + 20
    assert compensated > 30


@pytest.mark.usefixtures("of_t")
def test_colour_compensation(tmp_path: Path) -> None:
    by_itself, jointly = _run("colour_compensation", tmp_path)
    assert jointly > by_itself + 8
    assert jointly > 30


def test_inverse_light(tmp_path: Path) -> None:
    before, after = _run("inverse_light", tmp_path)
    assert after < 0.25 * before


@pytest.mark.usefixtures("coarse")
def test_spectrum(tmp_path: Path) -> None:
    direct, others, missed = _run("spectrum", tmp_path)
    assert direct > 0.8
    assert others < 0.4
    assert missed < 0.01


def test_painting(tmp_path: Path) -> None:
    _run("painting", tmp_path)
    assert (tmp_path / "page.html").stat().st_size > 1_000_000


def test_shape(tmp_path: Path) -> None:
    assert _run("shape", tmp_path) > 0.95
    assert (tmp_path / "corner.ply").read_bytes().startswith(b"ply\n")
