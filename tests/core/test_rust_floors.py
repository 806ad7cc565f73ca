"""Rust modules form no circle: what a file uses never leads back to it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

CRATES = Path(__file__).parents[2] / "crates"
# Both are bound to use what they stand for: tests their module, and a crate's root its modules.
LEFT_OUT = {"tests.rs", "lib.rs"}

Module = tuple[str, ...]


def _name(path: Path, root: Path) -> Module:
    parts = path.relative_to(root).with_suffix("").parts
    return parts[:-1] if parts[-1] == "mod" else parts


def _files(root: Path) -> dict[Module, Path]:
    files = (path for path in root.rglob("*.rs") if path.name not in LEFT_OUT)
    return {_name(path, root): path for path in files}


def _uses(text: str) -> set[str]:
    """Every path of a file that begins with crate, super or one of its own modules, unfolded.

    `use super::{a, b::{c, d}};` is super::a, super::b::c and super::b::d.
    """
    text = re.sub(r"//[^\n]*", "", text)
    own = "|".join(["crate", "super", "self", *re.findall(r"\bmod (\w+);", text)])
    found = set()
    for match in re.finditer(rf"(?<![\w:])((?:{own})(?:::\w+)*)(::[{{*])?", text):
        start, brace = match.groups()
        if brace == "::{":
            found |= {f"{start}::{rest}" for rest in _unfold(text, match.end())}
        elif "::" in match.group():
            found.add(start)
    return found


def _unfold(text: str, at: int) -> list[str]:
    """The paths between a brace that opens before `at` and the one that closes it."""
    depth, pieces, piece = 1, [], ""
    while depth:
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth == 0 or (depth == 1 and text[at] == ","):
            pieces.append(piece.strip())
            piece = ""
        else:
            piece += text[at]
        at += 1
    paths = []
    for piece in filter(None, pieces):
        start, brace, _ = piece.partition("::{")
        rest = _unfold(piece, len(start) + 3) if brace else []
        paths += [f"{start}::{path}" for path in rest] or [start]
    return paths


def _target(path: str, own: Module, inner: bool, files: dict[Module, Path]) -> Module | None:
    """The module that a path leads to; None where it is the file itself or the crate's root."""
    first, *rest = path.split("::")
    if first == "crate":
        place: Module = ()
    elif first == "super":
        # Inside a module that stands in the file itself this is the file.
        place = own if inner else own[:-1]
    else:
        place, rest = own, rest if first == "self" else [first, *rest]
    while rest and rest[0] == "super":
        place, rest = place[:-1], rest[1:]
    while rest and (*place, rest[0]) in files:
        place, rest = (*place, rest[0]), rest[1:]
    return place if place in files and place != own else None


def _graph(root: Path) -> dict[Module, set[Module]]:
    files = _files(root)
    graph = {}
    for own, path in files.items():
        outer, inner = _split(path.read_text())
        targets = {_target(use, own, False, files) for use in _uses(outer)}
        targets |= {_target(use, own, True, files) for use in _uses(inner)}
        graph[own] = {target for target in targets if target is not None}
    return graph


def _split(text: str) -> tuple[str, str]:
    """A file without the modules that stand in it, and those modules."""
    inner = re.findall(r"^mod \w+ \{\n.*?^\}", text, re.MULTILINE | re.DOTALL)
    for module in inner:
        text = text.replace(module, "")
    return text, "\n".join(inner)


def _circle(graph: dict[Module, set[Module]]) -> list[Module] | None:
    done: set[Module] = set()

    def visit(module: Module, trail: list[Module]) -> list[Module] | None:
        if module in trail:
            return [*trail[trail.index(module) :], module]
        if module in done:
            return None
        for target in sorted(graph[module]):
            if circle := visit(target, [*trail, module]):
                return circle
        done.add(module)
        return None

    for module in sorted(graph):
        if circle := visit(module, []):
            return circle
    return None


@pytest.mark.parametrize("crate", ["core", "python"])
def test_no_circles(crate: str) -> None:
    graph = _graph(CRATES / crate / "src")
    assert sum(map(len, graph.values())) >= len(graph), "the paths were not read"
    circle = _circle(graph)
    assert circle is None, " -> ".join("::".join(module) for module in circle or [])


def test_neighbours_know_the_solver_only_where_they_solve() -> None:
    graph = _graph(CRATES / "core" / "src")
    users = {own for own, targets in graph.items() if ("active_set",) in targets}
    assert users == {("coherent", "weighted")}


def test_a_circle_is_found(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    files = {
        "a/mod.rs": "mod one;\nmod two;\npub const SIZE: usize = 8;\nfn f() { one::g() }\n",
        "a/one.rs": "use super::two::{h, k};\nmod inner {\n    use super::g;\n}\n",
        "a/two.rs": "use crate::{b::c, d};\n",
        "b.rs": "// use super::a;\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    graph = _graph(tmp_path)
    assert graph == {
        ("a",): {("a", "one")},
        ("a", "one"): {("a", "two")},
        ("a", "two"): {("b",)},
        ("b",): set(),
    }
    assert _circle(graph) is None
    (tmp_path / "a" / "two.rs").write_text("use super::SIZE;\n")
    assert _circle(_graph(tmp_path)) == [("a",), ("a", "one"), ("a", "two"), ("a",)]
