"""What experiments and benchmarks share: options, cases, resuming, times, tables and files."""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.files.reading import parse_json
from lightmatrix.judgement.metrics import row_maximum
from lightmatrix.transport.matrix import LightTransport

Row = dict[str, Any]
C = TypeVar("C", bound="Case")
R = TypeVar("R")


class Case(Protocol):
    """The parameters of one measurement, a frozen dataclass."""

    @property
    def name(self) -> str:
        """A file name that is unique among the cases of the experiment."""


@dataclass(frozen=True, eq=False)
class Measured:
    """The result of a case: JSON-ready rows of the table, and arrays that the figure shows."""

    rows: list[Row]
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment(Generic[C]):
    """A figure: its cases, how to measure one, and how to draw the results."""

    # The name of the experiment and of its files.
    name: str
    # The cases of a quick (True) or a full run, in the order of measurement.
    cases: Callable[[bool], Iterable[C]]
    measure: Callable[[C], Measured]
    # Draws all results, in the order of the cases, into a folder.
    draw: Callable[[Path, list[tuple[C, Measured]]], None]
    # The parameters of a quick or a full run, JSON-ready.
    parameters: Callable[[bool], Mapping[str, Any]] | None = None
    # Makes the shorter table that is written as CSV, such as means over seeds.
    summary: Callable[[list[Row]], list[Row]] | None = None

    def run(
        self,
        out: Path,
        *,
        quick: bool = False,
        overwrite: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, Any]:
        """Measure all cases; write the table as JSON and CSV, and the figure, into a folder.

        Each result is kept in `out`/cases until all are there, so that an interrupted run
        continues. Returns the content of the JSON file: ``parameters``, ``rows`` and, with a
        summary, ``means``.
        """
        file, kept = out / f"{self.name}.json", out / "cases"
        if file.exists() and not overwrite:
            raise OutputError(f"{file}: exists already", hint="choose another folder or overwrite")
        kept.mkdir(parents=True, exist_ok=True)
        cases = list(self.cases(quick))
        results = []
        for done, case in enumerate(cases, start=1):
            results.append((case, self._measured(case, kept / f"{case.name}.npz")))
            if progress is not None:
                progress(done, len(cases))
        rows = all_rows(results)
        result: dict[str, Any] = {}
        if self.parameters is not None:
            result["parameters"] = dict(self.parameters(quick))
        result["rows"] = table = rows
        if self.summary is not None:
            result["means"] = table = self.summary(rows)
        self.draw(out, results)
        with (out / f"{self.name}.csv").open("w", newline="", encoding="utf-8") as opened:
            writer = csv.DictWriter(opened, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
        write_json(file, result)
        shutil.rmtree(kept)
        return result

    def _measured(self, case: C, file: Path) -> Measured:
        """The kept result of a case; it is measured if there is none or a damaged one."""
        try:
            arrays = read_npz(file)
            rows = parse_json(str(arrays.pop("rows")), f"{file}: rows", finite=False)
            return Measured(rows, arrays)
        except (InputError, KeyError):
            measured = self.measure(case)
        part = file.with_suffix(".part.npz")
        np.savez(part, rows=np.array(json.dumps(measured.rows)), **measured.arrays)  # type: ignore[arg-type]
        os.replace(part, file)
        return measured


def all_rows(results: Iterable[tuple[Any, Measured]]) -> list[Row]:
    """The rows of all cases."""
    return [row for _, measured in results for row in measured.rows]


def means(rows: Iterable[Row], keys: Sequence[str], values: Sequence[str]) -> list[Row]:
    """The means of some values over the rows, such as seeds, that have the same keys."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(json.dumps([row[key] for key in keys]), []).append(row)
    return [
        {
            **{key: group[0][key] for key in keys},
            "seeds": len(group),
            **{name: float(np.mean([row[name] for row in group])) for name in values},
        }
        for group in groups.values()
    ]


def options(module: str, doc: str | None) -> argparse.ArgumentParser:
    """The options of `python -m MODULE`, which prints the module's documentation as its help."""
    return argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def write_json(file: Path, content: Any) -> None:
    """Write results as JSON, into a folder that is made if there is none."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1) + "\n")


def markdown(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table as the documentation has it."""
    texts = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*texts, *("| " + " | ".join(line) + " |" for line in lines)])


def show(
    title: str, rows: Sequence[Row], columns: Mapping[str, str] | None = None, width: int = 150
) -> None:
    """Print rows as a table, with some columns under other heads; nothing where none has values."""
    columns = columns or {name: name for row in rows for name in row}
    used = {k: head for k, head in columns.items() if any(row.get(k) is not None for row in rows)}
    if not used:
        return
    table = Table(title=title, title_justify="left")
    for key, head in used.items():
        text = any(isinstance(row.get(key), str) for row in rows)
        table.add_column(head, justify="left" if text else "right", overflow="fold")
    for row in rows:
        table.add_row(*(_cell(row.get(key)) for key in used))
    Console(width=width).print(table)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def best_seconds(
    task: Callable[[], object], repeats: int, clock: Callable[[], float] = time.process_time
) -> float:
    """The shortest of some runs, in seconds of one processor core or of another clock."""
    took = []
    for _ in range(repeats):
        started = clock()
        task()
        took.append(clock() - started)
    return min(took)


def elsewhere(task: Callable[..., R], *arguments: Any) -> R:
    """The result of a function in another process, so that this one stays small."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
        return other.submit(task, *arguments).result()


def benchmark_exposure(truth: LightTransport) -> float:
    """The exposure at which a fifth of the rows have a single response that clips."""
    return 1 / float(np.quantile(row_maximum(truth), 0.8))
