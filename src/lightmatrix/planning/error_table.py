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
    """Errors of one estimator at one number of frames, from the least to the largest of the scenes.

    Parameters
    ----------
    estimator : str
        "plain" (row by row) or "coherent".
    frames : int
        Number of frames K.
    relative_error, relighting_error : (float, float)
        Smallest and largest error of the scenes: of T over all rows, and of relit images.
    scenes : tuple of str
        The scenes.
    measured : bool
        Whether this number of frames was measured; otherwise the errors are interpolated.
    """

    estimator: str
    frames: int
    relative_error: tuple[float, float]
    relighting_error: tuple[float, float]
    scenes: tuple[str, ...]
    measured: bool


def expectations(frames: int, *, exposures: str = "advised") -> list[ExpectedErrors]:
    """The errors of each estimator at a number of frames, with mixed patterns from 64 frames on.

    Errors between measured numbers of frames follow a power law; beyond them they are constant.
    `exposures` is "advised", those of `advise_exposures`, or "long", the single one of the
    benchmarks, at which a fifth of the rows have a single response that clips.
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
    """The smallest measured number of frames that reaches a relative error on the worst scene.

    The better estimator counts. If no number suffices, it is the largest one measured.
    """
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
