"""One harness for all experiments: cases measured one by one, kept, tabulated and drawn."""

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
    """What is measured at once: a frozen dataclass of parameters."""

    @property
    def name(self) -> str:
        """A file name that no other case of the experiment has."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a case gave.

    Parameters
    ----------
    rows : list of dict
        Lines of the table, JSON-ready.
    arrays : mapping of str to array
        Images that the figure shows.
    """

    rows: list[Row]
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment(Generic[C]):
    """What a figure shows and how it is measured.

    Parameters
    ----------
    name : str
        Of the command and of the files that are written.
    cases : callable
        The cases of a quick or a full run, in the order in which they are measured.
    measure : callable
        A case's rows of the table, and images.
    draw : callable
        Draws into a folder, from all that was measured: case by case, in order.
    parameters : callable, optional
        What the table was made with, from whether the run is quick; JSON-ready.
    summary : callable, optional
        A shorter table, from all rows, such as their means over seeds: the one written as CSV.
    """

    name: str
    cases: Callable[[bool], Iterable[C]]
    measure: Callable[[C], Measured]
    draw: Callable[[Path, list[tuple[C, Measured]]], None]
    parameters: Callable[[bool], Mapping[str, Any]] | None = None
    summary: Callable[[list[Row]], list[Row]] | None = None

    def run(
        self,
        out: Path,
        *,
        quick: bool = False,
        progress: Callable[[int, int], None] | None = None,
        kept: RunningResults | None = None,
    ) -> dict[str, Any]:
        """Measure all cases and write the table as JSON and CSV, and the figure.

        Parameters
        ----------
        out : Path
            An existing folder.
        quick : bool
            Few small cases, for a first look.
        progress : callable, optional
            Called with (done, all) cases.
        kept : RunningResults, optional
            Where finished cases are kept, for a run that goes on.

        Returns
        -------
        dict
            What the JSON file holds: ``parameters``, ``rows`` and, with a summary, ``means``.
        """
        chosen = list(self.cases(quick))
        found = []
        for done, case in enumerate(chosen, start=1):
            found.append((case, self._measured(case, kept)))
            if progress is not None:
                progress(done, len(chosen))
        rows = [row for _, measured in found for row in measured.rows]
        result: dict[str, Any] = {}
        if self.parameters is not None:
            result["parameters"] = dict(self.parameters(quick))
        result["rows"] = table = rows
        if self.summary is not None:
            result["means"] = table = self.summary(rows)
        (out / f"{self.name}.json").write_text(json.dumps(result, indent=1) + "\n")
        write_table(out / f"{self.name}.csv", table)
        self.draw(out, found)
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
    """What was kept of a case; None where there is nothing, or nothing whole."""
    try:
        arrays = read_npz(file)
        rows = parse_json(str(arrays.pop("rows")), f"{file}: rows", finite=False)
    except (InputError, KeyError):
        return None
    whole = isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
    return Measured(rows, arrays) if whole else None
