"""Limits on size: files, functions and signatures stay short, and folders do not form circles."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import lightmatrix as lm

ROOT = Path(__file__).parents[2] / "src" / "lightmatrix"
FILE_LINES = 400
FUNCTION_LINES = 80
PARAMETERS = 12

Function = ast.FunctionDef | ast.AsyncFunctionDef


def _files() -> list[Path]:
    return sorted(ROOT.rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def _functions(path: Path) -> Iterator[tuple[str, Function]]:
    for node in ast.walk(_tree(path)):
        if isinstance(node, Function):
            yield f"{_name(path)}:{node.name}", node


def _is_public(path: Path, function: Function) -> bool:
    """Whether users call it: a command, or a function of the door."""
    return path.is_relative_to(ROOT / "cli") or function.name in dir(lm)


def _length(function: Function, public: bool) -> int:
    """Lines of a function; without signature and docstring if it is public."""
    body = function.body
    if not public:
        return (function.end_lineno or 0) - function.lineno + 1
    documented = ast.get_docstring(function) is not None
    first = body[1].lineno if documented and len(body) > 1 else body[0].lineno
    return (function.end_lineno or 0) - first + 1


def _parameters(function: Function) -> int:
    arguments = function.args
    count = len(arguments.posonlyargs) + len(arguments.args) + len(arguments.kwonlyargs)
    return count + (arguments.vararg is not None) + (arguments.kwarg is not None)


def test_files_are_short() -> None:
    long = {_name(path) for path in _files() if len(path.read_text().splitlines()) > FILE_LINES}
    assert not long


def test_functions_are_short() -> None:
    long = {
        name
        for path in _files()
        for name, function in _functions(path)
        if _length(function, _is_public(path, function)) > FUNCTION_LINES
    }
    assert not long


def test_signatures_are_narrow() -> None:
    wide = {
        name
        for path in _files()
        for name, function in _functions(path)
        if _parameters(function) > PARAMETERS and not _is_public(path, function)
    }
    assert not wide


def _imported(path: Path) -> Iterator[str]:
    """Names of our modules that a file imports, without `lightmatrix.`."""
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lightmatrix."):
            inner = (node.module or "").removeprefix("lightmatrix.")
            for alias in node.names:
                whole = ROOT.joinpath(*inner.split("."), alias.name)
                is_module = whole.is_dir() or whole.with_suffix(".py").exists()
                yield f"{inner}.{alias.name}" if is_module else inner


PARENTS = [ROOT, *sorted(path for path in ROOT.rglob("*") if any(path.glob("*/*.py")))]


@pytest.mark.parametrize("parent", PARENTS, ids=_name)
def test_folders_do_not_import_each_other_in_a_circle(parent: Path) -> None:
    folders = {path.name for path in parent.iterdir() if any(path.glob("*.py"))}
    inside = parent.relative_to(ROOT).parts
    imports: dict[str, set[str]] = {folder: set() for folder in folders}
    for folder in folders:
        for path in (parent / folder).rglob("*.py"):
            for module in _imported(path):
                parts = tuple(module.split("."))
                if parts[: len(inside)] == inside and len(parts) > len(inside):
                    imports[folder] |= {parts[len(inside)]} & (folders - {folder})
    # Raises CycleError, which names the folders of a circle.
    TopologicalSorter(imports).prepare()
