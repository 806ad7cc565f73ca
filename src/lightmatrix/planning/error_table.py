"""The errors to expect from a number of frames, measured on rendered scenes.

The entry `made_by` of table.json is the command that measures the table.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from lightmatrix.patterns.mix import FEWEST_MIXED


@dataclass(frozen=True)
class ExpectedErrors:
    """Smallest and largest error of one estimator over the scenes, at one number of frames."""

    # "plain" (row by row) or "coherent".
    estimator: str
    frames: int
    # Errors of T over all rows, and of relit images.
    relative_error: tuple[float, float]
    relighting_error: tuple[float, float]
    scenes: tuple[str, ...]
    # Whether this number of frames was measured, and not interpolated.
    measured: bool


def expectations(frames: int, *, exposures: str = "advised") -> list[ExpectedErrors]:
    """The errors of each estimator at a number of frames, by a power law between measured ones.

    Patterns are mixed from 64 frames on. `exposures` is "advised" (`advise_exposures`) or "long",
    the benchmarks' single one, at which a fifth of the rows have a single response that clips.
    """
    rows = [
        row
        for row in table()
        if row["exposures"] == exposures
        and row["density"] == 0.5
        and row["patterns"] == ("mix" if row["frames"] >= FEWEST_MIXED else "fine")
    ]
    result = []
    for estimator in sorted({row["estimator"] for row in rows}, reverse=True):
        measured = [row for row in rows if row["estimator"] == estimator]
        scenes = tuple(sorted({row["scene"] for row in measured}))
        result.append(
            ExpectedErrors(
                estimator,
                frames,
                _range(measured, scenes, frames, "relative_error"),
                _range(measured, scenes, frames, "relighting_error"),
                scenes,
                any(row["frames"] == frames for row in measured),
            )
        )
    return result


def counts() -> list[int]:
    """The measured numbers of frames."""
    return sorted({int(row["frames"]) for row in table()})


def frames_for(error: float) -> int:
    """The fewest measured frames that reach an error on the worst scene, or the most."""
    for count in counts():
        if min(e.relative_error[1] for e in expectations(count)) <= error:
            return count
    return counts()[-1]


@cache
def table() -> list[dict[str, Any]]:
    """All rows of the table."""
    text = (files("lightmatrix.planning") / "table.json").read_text()
    rows: list[dict[str, Any]] = json.loads(text)["rows"]
    return rows


def _range(
    rows: list[dict[str, Any]], scenes: tuple[str, ...], frames: int, key: str
) -> tuple[float, float]:
    values = []
    for scene in scenes:
        points = sorted((row["frames"], row[key]) for row in rows if row["scene"] == scene)
        count, error = np.log([max(p[0], 1) for p in points]), np.log([p[1] for p in points])
        values.append(float(np.exp(np.interp(np.log(frames), count, error))))
    return min(values), max(values)
