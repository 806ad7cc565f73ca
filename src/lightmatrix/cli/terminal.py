"""What the commands print: text, tables, JSON and progress. Names are shown as they are.

Nothing that a user wrote is taken for markup: a bracket or a colon in the name of a file is one.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from lightmatrix.reprs import shown_value

# Rate and time left come from so many last seconds: stages of a few differ in pace.
_STEADY_SECONDS = 300.0
# What would move the cursor or change colours; tabs and ends of lines are fine.
_CONTROLS = dict.fromkeys((*range(9), *range(11, 32), 127), "\N{REPLACEMENT CHARACTER}")


class Stopped(KeyboardInterrupt):
    """Ctrl-C, with what is left to say about it."""


class FinishedError(Exception):
    """An output is whole, but what tells of it failed for want of memory.

    Parameters
    ----------
    words : str
    enough : bool
        Whether the output is all that was asked for.
    """

    def __init__(self, words: str, enough: bool) -> None:
        super().__init__(words)
        self.enough = enough


class _Plain(Console):
    """A console that prints what it is given, and lets its caller know of a reader that left."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=True, markup=False, emoji=False, highlight=False)

    def on_broken_pipe(self) -> None:
        raise  # Rich calls this while it handles the BrokenPipeError.


_out, _err = _Plain(), _Plain(stderr=True)


def say(text: str, style: str | None = None) -> None:
    """Print on standard output."""
    _out.print(_visible(text), style=style)


def warn(text: str, style: str | None = None) -> None:
    """Print on standard error."""
    _err.print(_visible(text), style=style)


def show_table(title: str, rows: Mapping[str, Any]) -> None:
    """Print names and values in two columns."""
    table = Table(
        title=_visible(title), title_justify="left", show_header=False, box=None, padding=(0, 2)
    )
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in rows.items():
        table.add_row(name, _visible(shown_value(value)))
    _out.print(table)


def show_columns(title: str, heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table of numbers with a head for each column."""
    table = Table(title=_visible(title), title_justify="left", box=None, padding=(0, 2))
    for head in heads:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*map(_visible, row))
    _out.print(table)


def show_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; numbers that are not finite become null."""
    sys.stdout.write(json.dumps(_jsonable(result), indent=2) + "\n")
    sys.stdout.flush()


@contextmanager
def progress(what: str, unit: str) -> Iterator[Any]:
    """A progress bar with rate and time left on a terminal; silent elsewhere.

    Yields a callback that takes (done, total) and, perhaps, a note to show behind the bar.
    """
    if not _err.is_terminal:
        yield lambda done, total, note="": None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    bar_of = Progress(*columns, console=_err, transient=True, speed_estimate_period=_STEADY_SECONDS)
    with bar_of as bar:
        task = bar.add_task(_visible(what), total=None, unit=unit, note="")
        yield lambda done, total, note="": bar.update(
            task, completed=done, total=total, note=_visible(note)
        )


class _Rate(ProgressColumn):
    """Steps per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{_short(speed)} {task.fields['unit']}/s")


def _short(value: float) -> str:
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.1f} {letter}"
    return f"{value:.1f}"


def _visible(text: str) -> str:
    return text.translate(_CONTROLS)


def _jsonable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # Arrays and numbers of NumPy.
        return _jsonable(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_jsonable(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else str(value)
