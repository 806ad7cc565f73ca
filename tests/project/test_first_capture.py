"""The page on the first capture: its commands run, and it lists every option of a virtual rig."""

from __future__ import annotations

import re
import shlex
from dataclasses import fields
from pathlib import Path

import pytest

from lightmatrix.cli import main
from lightmatrix.rig.devices.virtual import VirtualSettings

PAGE = (Path(__file__).parents[2] / "docs" / "first-capture.md").read_text()


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


def _quick(text: str) -> str:
    """The same with a small scene, and without waiting for the virtual devices."""
    text = text.replace("size=32", "size=32,real=0")
    return text.replace("virtual:l_objects", "virtual:l_objects,size=32,real=0")


@pytest.mark.usefixtures("small_scenes")
def test_its_commands_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line for block in _blocks("sh") for line in block.splitlines()]
    # Commands for devices need devices.
    virtual = [
        line for line in lines if "--projector" not in line and line != "lightmatrix rig list"
    ]
    assert len(virtual) == len(lines) - 2 >= 9
    for line in virtual:
        words = shlex.split(_quick(line))
        assert words[0] == "lightmatrix"
        assert main(words[1:]) == 0, line
    shown = capsys.readouterr().out
    assert "64 frames in capture" in shown
    assert "the projector's gamma is 2.20" in shown
    (python,) = _blocks("python")
    exec(compile(_quick(python), "first-capture.md", "exec"), {})
    shown = capsys.readouterr().out
    assert shown == "{}\n"


def test_it_lists_every_option_of_a_virtual_rig() -> None:
    table = dict(re.findall(r"^\| (`[a-z_`, ]+`) \|.*\| (.*) \|$", PAGE, flags=re.MULTILINE))
    defaults_by_name = {}
    for names, defaults in table.items():
        values = defaults.split(", ")
        for name, value in zip(re.findall(r"`(\w+)`", names), values, strict=False):
            defaults_by_name[name] = value
    for field in fields(VirtualSettings):
        if field.name != "scene":
            assert float(defaults_by_name[field.name]) == field.default, field.name
