"""What messages tell the user to write exists: parameters in the package, options in commands."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

import lightmatrix as lm
from lightmatrix.cli.app import app

ROOT = Path(lm.__file__).parent


def _texts() -> Iterator[tuple[str, str]]:
    """Each text of the package but docstrings, after the place where it stands."""
    for file in sorted(ROOT.rglob("*.py")):
        tree = ast.parse(file.read_text())
        bodies = [node.body for node in ast.walk(tree) if hasattr(node, "body")]
        documented = {
            id(body[0].value)
            for body in bodies
            if isinstance(body, list) and body and isinstance(body[0], ast.Expr)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and id(node) not in documented:
                yield f"{file.relative_to(ROOT)}:{node.lineno}", str(node.value)


def _options(command: Any) -> Iterator[str]:
    for parameter in command.params:
        yield from (*parameter.opts, *parameter.secondary_opts)
    for each in getattr(command, "commands", {}).values():
        yield from _options(each)


def _parameters() -> set[str]:
    names = set[str]()
    for each in (getattr(lm, name) for name in dir(lm)):
        for one in (each, *(vars(each).values() if inspect.isclass(each) else ())):
            call = getattr(one, "__func__", one)
            if inspect.isfunction(call) or (
                call is each and inspect.isclass(call) and not issubclass(call, Exception)
            ):
                names |= set(inspect.signature(call).parameters)
    return names


def test_hints_name_what_exists() -> None:
    options = {*_options(typer.main.get_command(app)), "--help", "--help-all", "--no-"}
    # Hints that say overwrite=True are shown as --overwrite; "in Python" says that there is none.
    words = (
        r'(?<![\w/.-])([a-z]+(?:_[a-z]+)*)=(?:True|False|"[a-z0-9]+"|[0-9.]+|\([0-9]+, [0-9]+\))'
    )
    # The example of a fault.
    options |= {"--shake"}
    missing, parameters = [], _parameters()
    for place, text in _texts():
        # Attributes of HTML and XML.
        if "<" in text:
            continue
        named = [] if "in Python" in text else re.findall(words, text)
        missing += [
            (place, name)
            for name in named
            if f"--{name.replace('_', '-')}" not in options
            or (name not in parameters and not place.startswith("cli/"))
        ]
        missing += [
            (place, each)
            for each in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)
            if each not in options
        ]
    assert missing == []
