"""What all commands share: sizes, progress, results on standard output."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
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

from lightmatrix.errors import InputError
from lightmatrix.files.markers import OutputKind
from lightmatrix.files.outputs import claimed
from lightmatrix.rig import library
from lightmatrix.rig.truth import Truth

out = Console(soft_wrap=True)
err = Console(stderr=True, soft_wrap=True)

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an output that exists.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Clip = Annotated[
    float | None,
    typer.Option(
        help="Raw level at which samples clip.", show_default="255, 65535, or 1 for float"
    ),
]
ResponseCurve = Annotated[
    str | None,
    typer.Option(
        "--response", help="linear, gamma:2.2, srgb or curve:FILE.", show_default="linear"
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of everything random.", min=0)]


def size(text: str) -> tuple[int, int]:
    """Read a size such as 128x128 (rows x columns) or 128."""
    match = re.fullmatch(r"(\d+)(?:[xX*](\d+))?", text.strip())
    if match is None:
        raise InputError(f"a size of {text!r}", hint="write rows x columns, such as 128x128")
    rows = int(match[1])
    cols = int(match[2] or rows)
    if rows < 1 or cols < 1:
        raise InputError(f"a size of {text!r}", hint="use at least 1x1")
    return rows, cols


# Outputs of the command that runs, locked until it ends (`main` closes it).
outputs = ExitStack()


def claim(output: Path, kind: OutputKind, *, overwrite: bool) -> Path:
    """Check an output before any work, and hold its lock until the command ends.

    Returns
    -------
    Path
        Where it will be written: links are followed to their end.
    """
    return outputs.enter_context(claimed(output, kind, overwrite=overwrite))


def known_truth(source: str, shape: tuple[int, int], report: Callable[[int, int], None]) -> Truth:
    """The matrix of a truth file (.npz), or of a scene at a size, rendered if need be."""
    if source.lower().endswith(".npz"):
        return Truth.load(Path(source))
    return library.truth(source, shape, progress=report)


class _Rate(ProgressColumn):
    """Steps per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{_short(speed)} {task.fields['unit']}/s")


@contextmanager
def progress(what: str, unit: str) -> Iterator[Any]:
    """A progress bar with rate and time left on a terminal; silent elsewhere.

    Yields a callback that takes (done, total).
    """
    if not err.is_terminal:
        yield lambda done, total: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(what, total=None, unit=unit)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _short(value: float) -> str:
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.1f} {letter}"
    return f"{value:.1f}"


def show_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; numbers that are not finite become null."""
    sys.stdout.write(json.dumps(_jsonable(result), indent=2) + "\n")


def _jsonable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_jsonable(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value if value is None else str(value)


def show_table(title: str, rows: Mapping[str, Any]) -> None:
    """Print names and values in two columns."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in rows.items():
        table.add_row(name, f"{value:.4g}" if isinstance(value, float) else str(value))
    out.print(table)
