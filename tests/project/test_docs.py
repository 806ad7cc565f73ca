"""The documentation: the site builds without warnings, and its lists are complete."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import typer
from axe_playwright_python.sync_playwright import Axe
from browser import opened

import lightmatrix as lm
from lightmatrix.cli.app import STAGES, app
from lightmatrix.rig.devices.virtual import VirtualSettings

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


def test_links_lead_somewhere() -> None:
    for document in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", document.read_text()):
            if not target.startswith("http"):
                assert (document.parent / target).exists(), f"{document.name} links to {target}"


def test_pages_name_options_that_commands_have() -> None:
    known = {"--help", "--help-all"}
    # Of Dask and of programs under benchmarks/ and experiments/, at the end of a longer text.
    known |= {"--nthreads", "--memory-limit", "--quick", "--show", "--scenes", "--half"}
    known |= {"--exposures"}
    for name in dict.fromkeys(member.__name__ for members in STAGES.values() for member in members):
        known.update(re.findall(r"--[a-z][a-z-]+", _help_of(name)))
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for line in page.read_text().splitlines():
            if not re.search(r"python -m |tools/|\b(dask|pip|feh) ", line):
                named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", line))
                assert named <= known, f"{page.name}: {line}"


def test_a_page_lists_every_option_of_a_virtual_rig() -> None:
    page = (ROOT / "docs" / "first-capture.md").read_text()
    table = dict(re.findall(r"^\| (`[a-z_`, ]+`) \|.*\| (.*) \|$", page, flags=re.MULTILINE))
    defaults_by_name = {}
    for names, defaults in table.items():
        values = defaults.split(", ")
        for name, value in zip(re.findall(r"`(\w+)`", names), values, strict=False):
            defaults_by_name[name] = value
    for field in fields(VirtualSettings):
        if field.name != "scene":
            assert float(defaults_by_name[field.name]) == field.default, field.name


def test_tables_fit_a_telephone_and_a_page_is_accessible(site: Path) -> None:
    """The pages with the widest tables, at 390 pixels; one with formulas, code and tables."""
    fits = "(e) => e.scrollWidth <= e.clientWidth"
    with opened() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 844})
        for name in ("response", "mathematics"):
            page.goto((site / f"{name}.html").as_uri())
            wraps = page.locator(".md-typeset__scrollwrap").all()
            assert wraps
            assert all(wrap.evaluate(fits) for wrap in wraps), name
        violations = {each["id"] for each in Axe().run(page).response["violations"]}
        # The theme's buttons that copy code are marked as places of their own.
        assert violations <= {"landmark-unique"}
