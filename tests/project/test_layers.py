"""Imports point only to lower layers, as docs/architecture.md numbers them.

And the base install suffices to import everything.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

TOP = Path(__file__).parents[2]
ROOT = TOP / "src" / "lightmatrix"

# From the ground up; a module may import from its own folder and from lower layers. The folders of
# one layer do not know each other; the single files of the ground may.
LAYERS = [
    {
        "defaults",
        "errors",
        "paths",
        "progress",
        "progress_bar",
        "ranges",
        "regions",
        "reprs",
        "_version",
        "_core",
    },
    {"resources"},
    {"files"},
    {"geometry", "patterns"},
    {"capture", "transport"},
    {"check", "pictures", "simulation", "solvers"},
    {"rig_model"},
    {"estimators", "judgement", "responses"},
    {"planning", "uses"},
    {"rig", "shape"},
    {"viewer"},
    {"report"},
    {"demo"},
    {"cli"},
    {"__main__"},
]
# Extras are imported inside the functions that need them, and nowhere else.
EXTRAS = {"mitsuba", "drjit", "glfw", "moderngl", "gi", "harvesters", "genicam", "av", "gphoto2"}
EXTRAS |= {"cv2", "OpenEXR", "rawpy", "distributed", "dask", "uvicorn", "websockets"}
EXTRAS |= {"anywidget", "traitlets"}
# The compiled core stands in the table by its crates.
CORE = "_core"
# Loads all else within the `try` that waits for a Ctrl-C.
ENTRY = ROOT / "cli" / "__init__.py"


def _layer(module: str) -> int:
    for number, layer in enumerate(LAYERS):
        if module in layer:
            return number
    raise AssertionError(f"{module} stands in no layer: add it to LAYERS")


def _modules() -> list[Path]:
    return sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def _imports(tree: ast.AST) -> set[str]:
    """Names of our own modules that a file imports, such as 'simulation.truth'."""
    modules = set()
    for node in ast.walk(tree):
        assert not (isinstance(node, ast.ImportFrom) and node.level), "imports are written in full"
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lightmatrix"):
            inner = (node.module or "").removeprefix("lightmatrix").lstrip(".")
            for alias in node.names:
                whole = f"{inner}.{alias.name}".lstrip(".")
                modules.add(whole if _is_module(whole) else inner)
        elif isinstance(node, ast.Import):
            names = {alias.name for alias in node.names if alias.name.startswith("lightmatrix.")}
            modules |= {name.removeprefix("lightmatrix.") for name in names}
    return modules - {""}


def _is_module(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").exists() or name == CORE


def test_the_layers_are_those_of_the_documented_table() -> None:
    table: dict[int, set[str]] = {}
    number = None
    for line in (TOP / "docs" / "architecture.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) != 5 or not cells[2].startswith("`"):
            continue
        # The number of a layer stands in its first line; the core and the API have words instead.
        number = cells[1] or number
        if number is not None and number.isdigit():
            names = re.findall(r"`([a-z_]+)(?:/|\.py)`", cells[2])
            table.setdefault(int(number), set()).update(names)
    assert table == {layer: names - {CORE} for layer, names in enumerate(LAYERS)}


def test_everything_stands_on_a_layer() -> None:
    there = {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in _modules()}
    assert there | {CORE} == set().union(*LAYERS)


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def test_imports_point_down() -> None:
    for path in _modules():
        place = path.relative_to(ROOT).parts[0].removesuffix(".py")
        for name in _imports(_tree(path)):
            other = name.split(".")[0]
            ground = _layer(place) == 0
            fine = other == place or _layer(other) < _layer(place) + ground
            assert fine, f"{path} imports {name}, which does not lie below it"


def test_nothing_imports_the_public_names_and_extras_alone_are_imported_inside_functions() -> None:
    for path in _modules():
        tree = _tree(path)
        top = {id(node) for node in tree.body}
        inside = path.relative_to(ROOT).parts[0] == "cli"
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                names = {node.module or ""}
                of_public = node.module == "lightmatrix"
                whole = of_public and not all(_is_module(alias.name) for alias in node.names)
            elif isinstance(node, ast.Import):
                names = {alias.name for alias in node.names}
                whole = "lightmatrix" in names
            else:
                continue
            assert inside or not whole, f"{path}:{node.lineno} imports the public API"
            extra = any(name.split(".")[0] in EXTRAS for name in names)
            if id(node) in top:
                assert not extra, f"{path} imports an extra at its top"
            elif not _under_main(tree, node) and path != ENTRY:
                assert extra, f"{path}:{node.lineno} imports {names} inside a function"


def _under_main(tree: ast.Module, node: ast.AST) -> bool:
    blocks = [part for part in tree.body if isinstance(part, ast.If)]
    return any(node in ast.walk(block) for block in blocks)


def test_no_circles() -> None:
    graph = {}
    for path in _modules():
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        graph[name] = _imports(_tree(path))
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, f"imports go round in a circle: {' -> '.join((*trail, name))}"
        if name not in done:
            for target in graph.get(name, ()):
                visit(target, (*trail, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_only_the_command_names_options() -> None:
    """Messages outside `cli/` name parameters, which the command shows as its options."""
    named = []
    for file in ROOT.rglob("*.py"):
        tree = _tree(file)
        # Docstrings may name an option, and so may lines of a command that are shown to be typed,
        # which the advice of `plan` consists of.
        bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
                continue
            option = re.search(r"(^|[ (`])--[a-z]", node.value) and "lightmatrix " not in node.value
            ours = file.parent.name == "cli" or file.name == "plan.py"
            if option and id(node) not in bare and not ours:
                named.append(f"{file.name}:{node.lineno}: {node.value}")
    assert named == []
