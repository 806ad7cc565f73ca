"""Every command and every line of Python in the README runs, in order."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.cli import main
from lightmatrix.files.images import write_image

ROOT = Path(__file__).parents[2]
# Commands that build or test the project, and commands of the shell.
NOT_RUN = ("make ", ". ")


def _blocks(language: str) -> list[str]:
    """Code of the README; smaller and with fewer patterns, since only whether it runs is tested."""
    text = (ROOT / "README.md").read_text()
    for large, small in (("64x64", "32x32"), ("(64, 64)", "(32, 32)"), ("-k 128", "-k 32")):
        assert large in text
        text = text.replace(large, small)
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def _commands() -> list[list[str]]:
    lines = "".join(_blocks("sh")).replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines]
    return [words for words in commands if words and not " ".join(words).startswith(NOT_RUN)]


@pytest.mark.usefixtures("small_scenes")
def test_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # What `make demo` writes beside it is in nobody's way.
    demo = re.search(r"demo -o (\S+)", (ROOT / "Makefile").read_text())
    assert demo is not None
    (tmp_path / demo[1]).mkdir()
    (tmp_path / demo[1] / "report.html").touch()
    commands = _commands()
    assert len(commands) >= 7
    scripts = _blocks("python")
    for words in commands:
        assert words[0] == "lightmatrix"
        if "white.png" in words:
            # The reader's own photographs: here the simulated ones, enlarged for binning.
            _own_photographs(tmp_path)
        assert main(words[1:]) == 0, " ".join(words)
        if words[1] == "export":
            (tmp_path / "script.py").write_text("\n".join(scripts))
            runpy.run_path(str(tmp_path / "script.py"))
            scripts = []
    assert not scripts


def _own_photographs(folder: Path) -> None:
    from lightmatrix.files.images import read_image
    from lightmatrix.files.stacks import list_images

    total = np.zeros((16, 16))
    paths = list_images(folder / "capture" / "images")
    for path in paths:
        image = read_image(path)[8:24, 8:24]
        total += image
        write_image(folder / "photos" / path.name, np.kron(image, np.ones((8, 8), np.uint8)))
    write_image(folder / "black.png", np.zeros((128, 128), np.uint8))
    # Half of white, which random patterns average to: no pixel of it clips.
    white = np.kron(total / len(paths), np.ones((8, 8)))
    write_image(folder / "white.png", white.astype(np.uint8))


def test_links_lead_somewhere() -> None:
    for document in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", document.read_text()):
            if not target.startswith("http"):
                assert (document.parent / target).exists(), f"{document.name} links to {target}"
