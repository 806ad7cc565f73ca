"""A manual page for each command: what it does, its arguments, options, examples and exit codes.

The pages are made from the command line itself; the examples are the lines of the README and of the
how-to pages that call the command.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from lightmatrix.cli.app import GROUPS, STAGES, app
from lightmatrix.cli.help import help_sections

ROOT = Path(__file__).parent.parent
PROGRAM = "lightmatrix"
FOLDER = "commands"
# A page shows at most this many examples.
_MOST_EXAMPLES = 4
# The exit codes of every command. Only `check` also has 1.
_EXIT_CODES = {
    "0": "done",
    "2": "bad input or output, with one message that says what would work",
    "3": "out of memory",
    "70": "a bug of lightmatrix (`LIGHTMATRIX_DEBUG=1` shows where)",
    "130": "stopped by Ctrl-C; the message says whether the command can go on",
}
_FOUND = {"0": "nothing is wrong", "1": "something is wrong"}


def command_pages() -> dict[str, str]:
    """The overview, `commands.md`, and a page for each command."""
    pages = {"commands.md": _overview()}
    for name, command in _all():
        pages[_page(name)] = _manual(name, command)
    return pages


def command_nav() -> list[str]:
    """The pages in the order of the overview."""
    return ["commands.md", *(_page(name) for name, _ in _all())]


def _all() -> Iterator[tuple[str, Any]]:
    """Every command by its whole name, such as "rig list", in the order of `--help`."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for stage in STAGES:
        yield from ((name, commands[name]) for name in _of_stage(stage) if name not in _groups())
        for group in GROUPS.get(stage, {}):
            for name, command in commands[group].commands.items():
                yield f"{group} {name}", command


def _groups() -> set[str]:
    return {name for groups in GROUPS.values() for name in groups}


def _of_stage(stage: str) -> list[str]:
    return [*(member.__name__ for member in STAGES[stage]), *GROUPS.get(stage, {})]


def _page(name: str) -> str:
    return f"{FOLDER}/{name.replace(' ', '-')}.md"


def _overview() -> str:
    lines = ["# Commands", "", f"`{PROGRAM} COMMAND --help-all` shows the same.", ""]
    every = dict(_all())
    for stage in STAGES:
        lines += [f"## {stage}", "", "| command | what it does |", "|---|---|"]
        for member in _of_stage(stage):
            for name in (name for name in every if name.split()[0] == member):
                short = _paragraphs(every[name].help or "").split("\n\n")[0]
                link = f"[{name}]({_page(name)}){{ #{name.replace(' ', '-')} }}"
                lines.append(f"| {link} | {_cell(short)} |")
        lines.append("")
    lines += [
        "## All of them",
        "",
        f"`{PROGRAM} --install-completion` teaches the shell their names, options and values; "
        f"`{PROGRAM} --version` prints the version.",
        "",
        *_table(("exit code", "meaning"), _EXIT_CODES | {"1": "`check` found a fault"}),
    ]
    return "\n".join(lines)


def _manual(name: str, command: Any) -> str:
    context = command.make_context(f"{PROGRAM} {name}", [], resilient_parsing=True)
    usage = " ".join(command.get_usage(context).split()).removeprefix("Usage: ")
    lines = [f"# {name}", "", _paragraphs(command.help or ""), "", "```text", usage, "```", ""]
    for heading, records in help_sections(command, context).items():
        meanings = {f"`{words}`": meaning for words, meaning in records}
        kind = "argument" if heading == "Arguments" else "option"
        lines += [f"## {heading}", "", *_table((kind, "meaning"), meanings)]
    examples = _examples(name)
    if examples:
        lines += ["## Examples", "", "```sh", *examples, "```", ""]
    codes = _EXIT_CODES | (_FOUND if name == "check" else {})
    lines += ["## Exit codes", "", *_table(("code", "meaning"), codes)]
    return "\n".join(lines)


def _examples(name: str) -> list[str]:
    """Lines of the documentation that call a command, each with other options."""
    lines: dict[str, str] = {}
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for block in re.findall(r"^```sh\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL):
            for line in block.splitlines():
                words = line.split("  #")[0].split()
                if words[: 1 + len(name.split())] == [PROGRAM, *name.split()]:
                    options = sorted(word for word in words if word.startswith("-"))
                    lines.setdefault(" ".join(options), " ".join(words))
    return list(lines.values())[:_MOST_EXAMPLES]


def _table(heads: tuple[str, str], rows: dict[str, str]) -> list[str]:
    lines = [f"| {heads[0]} | {heads[1]} |", "|---|---|"]
    return [*lines, *(f"| {name} | {_cell(rows[name])} |" for name in _in_order(rows)), ""]


def _in_order(rows: dict[str, str]) -> list[str]:
    """Exit codes by number, options in their own order."""
    return sorted(rows, key=int) if all(name.isdecimal() for name in rows) else list(rows)


def _paragraphs(text: str) -> str:
    return "\n\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def _cell(text: str) -> str:
    # Typer puts defaults that are words into another pair of brackets.
    plain = re.sub(r"\[default: \((.*)\)\]", r"[default: \1]", " ".join(text.split()))
    return html.escape(plain, quote=False).replace("|", "\\|")
