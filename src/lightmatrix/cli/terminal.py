"""What the commands print: text, tables, JSON and progress bars.

Text is never read as markup: brackets and colons in file names appear as they are.
"""

import json
import math
import re
import select
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from rich.console import Console
from rich.table import Table

from lightmatrix.progress_bar import progress_bar, visible
from lightmatrix.reprs import shown_value


class _Plain(Console):
    """A console without markup that raises BrokenPipeError when the reader has left."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=True, markup=False, emoji=False, highlight=False)

    def on_broken_pipe(self) -> None:
        raise  # Rich calls this while it handles the error.


_out, _err = _Plain(), _Plain(stderr=True)


def as_options(text: str) -> str:
    """The text with each parameter of a function, such as overwrite=True, as the option it is."""

    def option(match: re.Match[str]) -> str:
        name, value = match[1].replace("_", "-"), match[2].strip('"').strip("()").replace(", ", "x")
        return {"True": f"--{name}", "False": f"--no-{name}"}.get(value, f"--{name} {value}")

    # A name, and True, False, a text in quotes, a number, or a pair of numbers.
    value = r'True|False|"[^"\n]*"|[0-9.]+|\([0-9]+, [0-9]+\)'
    return re.sub(rf"(?<![\w/.-])([a-z]+(?:_[a-z]+)*)=({value})", option, text)


def say(text: str, style: str | None = None) -> None:
    """Print on standard output."""
    _out.print(visible(text), style=style)


def warn(text: str, style: str | None = None) -> None:
    """Print on standard error."""
    _err.print(visible(text), style=style)


def enter_was_pressed() -> bool:
    """Whether a line was typed on the terminal since the last look."""
    # Windows cannot wait for a console so; Ctrl-C ends a command there.
    if not sys.stdin.isatty() or sys.platform == "win32":
        return False
    pressed = bool(select.select([sys.stdin], [], [], 0)[0])
    if pressed:
        sys.stdin.readline()
    return pressed


def show_table(title: str, rows: Mapping[str, Any]) -> None:
    """Print names and values in two columns."""
    table = Table(
        title=visible(title), title_justify="left", show_header=False, box=None, padding=(0, 2)
    )
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in rows.items():
        table.add_row(name, visible(shown_value(value)))
    _out.print(table)


def show_columns(title: str, heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table of numbers with a heading for each column."""
    table = Table(title=visible(title), title_justify="left", box=None, padding=(0, 2))
    for head in heads:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*map(visible, row))
    _out.print(table)


def judged_json(judged: Any) -> dict[str, Any]:
    """The `Verdicts` on an estimate as commands print them."""
    overall = judged.transport
    return {"verdict": overall.level, "sentence": overall.sentence, "verdicts": judged.as_dict()}


def show_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; numbers that are not finite become null."""
    sys.stdout.write(json.dumps(_jsonable(result), indent=2) + "\n")
    sys.stdout.flush()


def answer(as_json: bool, result: Mapping[str, Any], *lines: str) -> None:
    """Print what a command has done: one JSON object, or lines of text."""
    if as_json:
        show_json(result)
        return
    for line in lines:
        say(line)


@contextmanager
def progress(what: str, unit: str) -> Iterator[Any]:
    """Show a progress bar on a terminal; yields a callback of (done, total[, note])."""
    if not _err.is_terminal:
        yield lambda done, total, note="": None
        return
    with progress_bar(what, unit, _err) as step:
        yield step


class Stages(ExitStack):
    """Progress of a rig; two bars at once would overwrite each other, so there is one at a time."""

    _title = ""
    _bar: Callable[..., None]

    def measured(self, part: str, done: int, total: int) -> None:
        """Progress of measuring a part of the rig."""
        self._update(f"measuring {part}", "looks", done, total)

    def photographed(self, step: Any) -> None:
        """Progress of a capture after a frame, a `lightmatrix.rig.session.Step`."""
        note = f"{100 * step.clipped:.1f} % clipped"
        self._update("photographing", "frames", step.done, step.total, note)

    def _update(self, title: str, unit: str, done: int, total: int, note: str = "") -> None:
        if title != self._title:
            self.close()
            self._title, self._bar = title, self.enter_context(progress(title, unit))
        self._bar(done, total, note)


def _jsonable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers
        return _jsonable(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_jsonable(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else str(value)
