"""The ways in which `mutants.py` breaks a source file: one change of its syntax tree a mutant.

Docstrings, annotations, decorators and texts stay as they are, and so do sizes of tiles by memory
(shifts, and statements with a name that ends in _BYTES), since they change no result.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change: change number `choice` of node number `node` in the syntax tree of the file.

    The statement around it spans the lines `first` to `last`: tests that run one can kill it.
    """

    file: Path
    node: int
    choice: int
    line: int
    first: int
    last: int
    change: str

    def described(self) -> dict[str, Any]:
        """The mutant as a row of the report."""
        return {"file": str(self.file), "line": self.line, "change": self.change}


def mutants_of(file: Path, source: str) -> Iterator[Mutant]:
    """All mutants of a file."""
    tree = ast.parse(source)
    left_alone = _left_alone(tree)
    statements = _statements(tree)
    for number, node in enumerate(ast.walk(tree)):
        if node in left_alone:
            continue
        for choice, new in enumerate(_changes(node)):
            old, shown = ast.unparse(node).split("\n")[0], ast.unparse(new).split("\n")[0]
            first, last = statements.get(node, (node.lineno, node.end_lineno))  # type: ignore[attr-defined]
            yield Mutant(
                file, number, choice, node.lineno, first, last, f"{old} -> {shown}"  # type: ignore[attr-defined]
            )  # fmt: skip


def mutated(source: str, mutant: Mutant) -> str:
    """The source with the change."""
    tree = ast.parse(source)
    node = next(n for i, n in enumerate(ast.walk(tree)) if i == mutant.node)
    new = list(_changes(node))[mutant.choice]
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is node:
                setattr(parent, name, new)
            elif isinstance(value, list) and any(item is node for item in value):
                value[[item is node for item in value].index(True)] = new
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def _changes(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes that may replace a node."""
    match node:
        case ast.Compare():
            for place, operator in enumerate(node.ops):
                if type(operator) in COMPARISONS:
                    new = copy.deepcopy(node)
                    new.ops[place] = COMPARISONS[type(operator)]()
                    yield new
        case ast.BinOp() if type(node.op) in ARITHMETIC:
            yield ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
        case ast.AugAssign() if type(node.op) in ARITHMETIC:
            yield ast.AugAssign(node.target, ARITHMETIC[type(node.op)](), node.value)
            yield ast.Pass()
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert()):
            yield node.operand
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float() as value):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.If() | ast.IfExp() | ast.While():
            turned = copy.copy(node)
            turned.test = ast.UnaryOp(ast.Not(), node.test)
            yield turned
        case ast.Return(value=ast.expr()) if not _is_none(node.value):
            yield ast.Return(ast.Constant(None))
        case ast.Raise() | ast.Break() | ast.Continue() | ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield ast.Pass()


def _is_none(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _of_memory(statement: ast.stmt) -> bool:
    names = (n.id for n in ast.walk(statement) if isinstance(n, ast.Name))
    return any(name.endswith("_BYTES") for name in names)


def _left_alone(tree: ast.AST) -> set[ast.AST]:
    """Nodes within annotations, decorators, texts and shifts."""
    roots: list[ast.AST | None] = []
    for node in ast.walk(tree):
        match node:
            case ast.AnnAssign() | ast.arg():
                roots.append(node.annotation)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                roots += [node.returns, *node.decorator_list]
            case ast.ClassDef():
                roots += node.decorator_list
            case ast.JoinedStr() | ast.BinOp(op=ast.LShift()):
                roots.append(node)
            case ast.stmt() if not hasattr(node, "body") and _of_memory(node):
                roots.append(node)
            # Aliases such as `Tile = tuple[...]` are annotations too.
            case ast.Assign(value=ast.Subscript(value=ast.Name(id="tuple" | "Callable"))):
                roots.append(node)
    return {inner for root in roots if root is not None for inner in ast.walk(root)}


def _statements(tree: ast.AST) -> dict[ast.AST, tuple[int, int]]:
    """The lines of the innermost statement around each node; only the head of a compound one."""
    spans: dict[ast.AST, tuple[int, int]] = {}

    def visit(node: ast.AST, lines: tuple[int, int] | None) -> None:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno
            lines = (node.lineno, max(node.lineno, last or node.lineno))
        if lines is not None:
            spans[node] = lines
        for child in ast.iter_child_nodes(node):
            visit(child, lines)

    visit(tree, None)
    return spans
