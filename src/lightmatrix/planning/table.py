"""The error to expect from so many frames: measured on rendered scenes, not promised for others.

The table is `table.json`; its own entry `made_by` is the command that makes it again.
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
    """Errors measured on the rendered scenes under one plan.

    Parameters
    ----------
    estimator : str
        "plain" (row by row) or "coherent".
    frames : int
        Number of frames K.
    relative_error, relighting_error : (float, float)
        Least and largest of the scenes: of T over all rows, and of images under unseen patterns.
    scenes : tuple of str
        On which they were measured.
    measured : bool
        Whether with this number of frames, or between or beyond those that were measured.
    """

    estimator: str
    frames: int
    relative_error: tuple[float, float]
    relighting_error: tuple[float, float]
    scenes: tuple[str, ...]
    measured: bool


def expectations(frames: int, *, exposures: str = "advised") -> list[ExpectedErrors]:
    """What each estimator reached with so many frames, patterns mixed from 64 on.

    Between numbers of frames that were measured errors follow a power law; beyond them the
    nearest one is given.

    Parameters
    ----------
    frames : int
        Number of frames K.
    exposures : {"advised", "long"}
        Those of `advise_exposures`, or the benchmarks' single one, at which a fifth of the rows
        have a single response that clips.
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
        mine = [row for row in rows if row["estimator"] == estimator]
        scenes = tuple(sorted({row["scene"] for row in mine}))
        result.append(
            ExpectedErrors(
                estimator,
                frames,
                _range(mine, scenes, frames, "relative_error"),
                _range(mine, scenes, frames, "relighting_error"),
                scenes,
                any(row["frames"] == frames for row in mine),
            )
        )
    return result


def counts() -> list[int]:
    """Numbers of frames that were measured."""
    return sorted({int(row["frames"]) for row in table()})


def frames_for(error: float) -> int:
    """The least measured number of frames whose relative error is expected to be at most this.

    By the better estimator and the worst scene; the largest number measured if none suffices.
    """
    for count in counts():
        if min(e.relative_error[1] for e in expectations(count)) <= error:
            return count
    return counts()[-1]


@cache
def table() -> list[dict[str, Any]]:
    """All measured rows."""
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
