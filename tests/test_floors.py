"""Imports point only to lower floors, and the base install suffices to import everything."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "src" / "lightmatrix"

# From the ground up; a module may import from its own floor and from those below it.
FLOORS = [
    {"errors", "_core", "atomic", "png16", "images"},
    {"shares", "exposures", "patterns", "pattern_mix", "pattern_kinds", "sensor", "transport"},
    {
        "pattern_folder",
        "frames",
        "frame_prediction",
        "frame_order",
        "capture",
        "capture_checks",
        "capture_folder",
        "transport_file",
        "exchange",
        "checkpoint",
        "store",
        "white_frame",
    },
    {"solvers"},
    {"estimators", "rig"},
    {"plan", "plan_table", "evaluate", "figures"},
    {"experiments"},
    {"cli"},
]
# Extras are imported inside the functions that need them, and nowhere else.
EXTRAS = {"mitsuba", "drjit"}


def _floor(module: str) -> int:
    for number, floor in enumerate(FLOORS):
        if module in floor:
            return number
    raise AssertionError(f"{module} stands on no floor: add it to FLOORS")


def _modules() -> list[Path]:
    return sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def _imports(tree: ast.AST) -> set[str]:
    """Names of our own modules that a file imports, such as 'rig.truth'."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lightmatrix"):
            inner = (node.module or "").removeprefix("lightmatrix").lstrip(".")
            for alias in node.names:
                whole = f"{inner}.{alias.name}".lstrip(".")
                found.add(whole if _is_module(whole) else inner)
        elif isinstance(node, ast.Import):
            names = {alias.name for alias in node.names if alias.name.startswith("lightmatrix.")}
            found |= {name.removeprefix("lightmatrix.") for name in names}
    return found - {""}


def _is_module(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").exists() or name == "_core"


@pytest.mark.parametrize("path", _modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_down(path: Path) -> None:
    own = _floor(path.relative_to(ROOT).parts[0].removesuffix(".py"))
    tree = ast.parse(path.read_text())
    for name in _imports(tree):
        assert _floor(name.split(".")[0]) <= own, f"{path} imports {name} from a higher floor"


@pytest.mark.parametrize("path", _modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_only_extras_are_imported_inside_functions(path: Path) -> None:
    tree = ast.parse(path.read_text())
    top = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        names = (
            {node.module or ""}
            if isinstance(node, ast.ImportFrom)
            else {a.name for a in node.names}
        )
        extra = any(name.split(".")[0] in EXTRAS for name in names)
        if id(node) in top:
            assert not extra, f"{path} imports an extra at its top"
        elif not _under_main(tree, node):
            assert extra, f"{path}:{node.lineno} imports {names} inside a function"


def _under_main(tree: ast.Module, node: ast.AST) -> bool:
    blocks = [part for part in tree.body if isinstance(part, ast.If)]
    return any(node in ast.walk(block) for block in blocks)


def test_no_circles() -> None:
    graph = {}
    for path in _modules():
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        graph[name] = _imports(ast.parse(path.read_text()))
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, f"imports go round in a circle: {' -> '.join((*trail, name))}"
        if name not in done:
            for target in graph.get(name, ()):
                visit(target, (*trail, name))
            done.add(name)

    for name in graph:
        visit(name, ())
