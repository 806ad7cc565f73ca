"""The documentation: the site builds without warnings, and the commands on its pages work."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import typer
from axe_playwright_python.sync_playwright import Axe
from browser import opened
from PIL import Image

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.cli.app import STAGES, app
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import SimulatedCapture

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole site. A warning is an error, among them links and anchors that lead nowhere."""
    folder = tmp_path_factory.mktemp("site")
    # Not --quiet, which would leave warnings uncounted.
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder)]
    built = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return folder


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        text = page.read_text()
        loaded = re.findall(r"<(?:img|script)[^>]*\ssrc=\"?([^\s\">]+)", text)
        loaded += re.findall(r"<link[^>]*rel=\"?stylesheet\"?[^>]*href=\"?([^\s\">]+)", text)
        for address in loaded:
            assert not re.match("(?:https?:)?//", address), f"{page.name} loads {address}"
        assert not re.search(r"<img(?![^>]*\salt=)", text), f"{page.name}: a picture without words"


def test_the_reference_has_every_public_name(site: Path) -> None:
    reference = "".join(page.read_text() for page in (site / "reference").glob("*.html"))
    for name in dir(lm):
        if not name.startswith("_"):
            home = getattr(lm, name).__module__
            assert f'id="{home}.{name}"' in reference or f'.{name}"' in reference, name
    commands = (site / "commands.html").read_text()
    for members in STAGES.values():
        for member in members:
            assert f'id="{member.__name__}"' in commands
            manual = (site / "commands" / f"{member.__name__}.html").read_text()
            assert "Exit codes" in manual
            for option in re.findall(r"--[a-z-]+", _help_of(member.__name__)):
                assert option in manual or option == "--help"
    assert "--rig-file" in (site / "commands" / "rig-settle.html").read_text()
    # Its examples come from the README.
    assert "l_objects" in (site / "commands" / "simulate.html").read_text()
    # Formulas are MathML, and none is left as source.
    mathematics = (site / "mathematics.html").read_text()
    assert mathematics.count("<math") > 40
    assert "arithmatex" not in mathematics


def _help_of(name: str) -> str:
    command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    context = command.make_context(name, [], resilient_parsing=True)
    return str(command.get_help(context))


def test_the_page_of_settings_is_up_to_date() -> None:
    command = [sys.executable, str(ROOT / "tools" / "settings_table.py"), "--check"]
    assert subprocess.run(command).returncode == 0, "run python tools/settings_table.py"


@pytest.mark.parametrize("name", ["report", "other-programs", "colour", "operator"])
def test_the_commands_of_a_page_work(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # What the settings give is tested elsewhere. Coherent estimates take seconds, and so do checks
    # of three colours, and of as many photographs as a report takes.
    checked = name not in ("colour", "report")
    quick = partial(lm.estimate, coherent=False, check=checked)
    monkeypatch.setattr(lm, "estimate", quick)
    monkeypatch.setattr(lm, "estimate_colour", partial(lm.estimate_colour, check=False))
    truth = ProceduralScene((24, 32), (32, 32), seed=1).truth()
    capture = lm.simulate(truth, lm.BernoulliPatterns((32, 32), 24))
    capture.save("capture")
    quick(capture, output="scene.zarr")
    camera = np.array([[30.0, 0, 16, 0], [0, 30, 12, 0], [0, 0, 1, 0]])
    projector = np.array([[30.0, 0, 16, -9], [0, 30, 16, 0], [0, 0, 1, 0]])
    lm.RigGeometry(camera, projector, (24, 32), (32, 32)).save("geometry.json")
    if name == "colour":
        _in_colour(capture)
        ProceduralScene((12, 12), (12, 12), seed=1).truth().save(Path("small.npz"))
    # The commands run at smaller sizes, and on a fainter scene, which takes more exposure.
    text = (ROOT / "docs" / f"{name}.md").read_text()
    text = re.sub(r"(--size |\()64(, 64)?", lambda found: found[0].replace("64", "12"), text)
    text = text.replace("-k 64", "-k 16").replace("l_objects", "small.npz")
    text = text.replace("--exposure 0.4", "--exposure 2")
    commands = re.findall(r"^ *(lightmatrix .*)$", text, flags=re.MULTILINE)
    assert commands
    for line in commands:
        for colour in ("red", "green", "blue") if "$colour" in line else ("",):
            words = line.replace("$colour", colour)
            if " estimate " in words:
                words += " --no-check" * (not checked) + " --no-coherent" * bool(colour)
            assert main(shlex.split(words)[1:]) == 0, words
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert blocks
    (tmp_path / "script.py").write_text("\n".join(blocks))
    runpy.run_path("script.py")


@pytest.mark.usefixtures("small_scenes")
def test_the_page_of_a_picture_on_a_wall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its commands run at a smaller size, and the camera sees more of the picture each time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(lm, "estimate", partial(lm.estimate, check=False, correct="none"))
    colours = np.random.default_rng(0).integers(60, 255, (6, 8, 3), np.uint8)
    Image.fromarray(np.kron(colours, np.ones((8, 8, 1), np.uint8))).save("picture.jpg")
    text = (ROOT / "docs" / "picture-on-a-wall.md").read_text()
    (block,) = re.findall(r"^RIG=(.*)$", text, flags=re.MULTILINE)
    said = ""
    for line in re.findall(r"^(lightmatrix .*)$", text, flags=re.MULTILINE):
        words = line.replace("$RIG", f"{block},size=32,real=0").replace("-k 64", "-k 24")
        assert main(shlex.split(words)[1:]) == 0, words
        said += capsys.readouterr().out
    before, after = map(float, re.findall(r"([0-9.]+) dB", said.split("photograph 0")[0]))
    assert before > after + 5
    assert "by the rig" in said
    assert {path.name for path in Path().iterdir()} >= {"seen.png", "better.png", "wall.mpcdi"}


def _in_colour(capture: SimulatedCapture) -> None:
    """Replace the grey photographs by some of three channels."""
    lm.write_patterns("patterns", capture.patterns)
    for k in range(capture.count):
        frame = capture.frame(k)
        shown = np.stack([frame, frame // 2, frame // 3], axis=-1)
        lm.write_image(f"photos/photo_{k:03d}.png", shown)
    colourful = lm.Capture.from_folders("patterns", "photos")
    lm.estimate(colourful, coherent=False, check=False, output="scene.zarr", overwrite=True)
    lm.write_image("picture.png", np.random.default_rng(0).random((32, 32, 3)))


def test_tables_fit_a_telephone_and_a_page_is_accessible(site: Path) -> None:
    """The pages with the widest tables, at 390 pixels; one with formulas, code and tables."""
    fits = "(e) => e.scrollWidth <= e.clientWidth"
    with opened() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 844})
        for name in ("response", "simulation", "viewer", "mathematics"):
            page.goto((site / f"{name}.html").as_uri())
            wraps = page.locator(".md-typeset__scrollwrap").all()
            assert wraps
            assert all(wrap.evaluate(fits) for wrap in wraps), name
        violations = {each["id"] for each in Axe().run(page).response["violations"]}
        # The theme's buttons that copy code are marked as places of their own.
        assert violations <= {"landmark-unique"}
