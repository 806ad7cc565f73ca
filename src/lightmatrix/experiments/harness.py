"""The harness of all experiments: it measures case by case, keeps results, tabulates and draws."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.json_files import parse_json
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.outputs.running import RunningResults

Row = dict[str, Any]
C = TypeVar("C", bound="Case")


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

    # The name of the command and of the output files.
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
        progress: Callable[[int, int], None] | None = None,
        kept: RunningResults | None = None,
    ) -> dict[str, Any]:
        """Measure all cases; write the table as JSON and CSV, and the figure, into a folder.

        `kept` holds the results of an interrupted run. Returns the content of the JSON file:
        ``parameters``, ``rows`` and, with a summary, ``means``.
        """
        cases = list(self.cases(quick))
        results = []
        for done, case in enumerate(cases, start=1):
            results.append((case, self._measured(case, kept)))
            if progress is not None:
                progress(done, len(cases))
        rows = all_rows(results)
        result: dict[str, Any] = {}
        if self.parameters is not None:
            result["parameters"] = dict(self.parameters(quick))
        result["rows"] = table = rows
        if self.summary is not None:
            result["means"] = table = self.summary(rows)
        (out / f"{self.name}.json").write_text(json.dumps(result, indent=1) + "\n")
        write_table(out / f"{self.name}.csv", table)
        self.draw(out, results)
        return result

    def _measured(self, case: C, kept: RunningResults | None) -> Measured:
        name = f"{case.name}.npz"
        known = _read(kept.file(name)) if kept is not None and kept.has(name) else None
        if known is None:
            known = self.measure(case)
            if kept is not None:
                with kept.keep(name) as part:
                    _write(part, known)
        return known


def all_rows(results: Iterable[tuple[Any, Measured]]) -> list[Row]:
    """The rows of all cases."""
    return [row for _, measured in results for row in measured.rows]


def write_table(file: Path, rows: Sequence[Row]) -> None:
    """Write rows of equal keys as CSV."""
    with file.open("w", newline="", encoding="utf-8") as opened:
        table = csv.DictWriter(opened, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def _write(file: Path, measured: Measured) -> None:
    arrays: dict[str, Any] = {**measured.arrays, "rows": np.array(json.dumps(measured.rows))}
    np.savez(file, **arrays)


def _read(file: Path) -> Measured | None:
    """A kept result; None if it is missing or damaged."""
    try:
        arrays = read_npz(file)
        rows = parse_json(str(arrays.pop("rows")), f"{file}: rows", finite=False)
    except (InputError, KeyError):
        return None
    whole = isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
    return Measured(rows, arrays) if whole else None
