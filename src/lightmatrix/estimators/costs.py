"""What an estimate takes of memory and time, by its size.

The numbers come from measurements: `python -m benchmarks.needs` makes procedural captures of many
sizes, estimates each in a process of its own on one core (peak of resident memory beyond what is
loaded anyway, CPU seconds), and fits `COEFFICIENTS` to them. They hold within a factor of about
1.5 in memory and 2 in time on the machine that they were measured on (AMD EPYC, 2026-11).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from lightmatrix.estimators.coherent.neighbourhood import UNSEEN
from lightmatrix.estimators.coherent.stages import SPACINGS, spacings
from lightmatrix.estimators.join import TILE_BYTES
from lightmatrix.resources.disk import SCRATCH_MEMORY_BYTES
from lightmatrix.solvers.active_set import ActiveSet

# Of `memory_terms` in bytes and of `time_terms` in seconds of one core; growing is the coherent
# estimate of large frames, where few rows look everywhere.
COEFFICIENTS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "coherent": {
        "bytes": {"pixel": 2048, "value": 31, "tile": 0.62, "row": 1580, "sample": 1},
        "seconds": {
            "value": 3.0e-7,
            "row": 2.4e-4,
            "sample": 7.1e-6,
            "entry": 5.7e-8,
            "grey entry": 4.8e-10,
        },
    },
    "growing": {
        "bytes": {"pixel": 1200, "value": 14, "tile": 0.4, "row": 1310, "sample": 1},
        "seconds": {
            "value": 3.0e-7,
            "row": 2.0e-4,
            "sample": 5.6e-6,
            "entry": 4.0e-10,
            "grey entry": 1.0e-11,
        },
    },
    "plain": {
        "bytes": {"pixel": 640, "value": 0.71, "row": 400, "sample": 15},
        "seconds": {"row": 8.8e-6, "sample": 2.2e-7, "entry": 1.9e-11, "grey entry": 8.3e-10},
    },
}
# Share of the rows that look everywhere because light that grew onto them does not explain them.
_UNEXPLAINED = 0.003
# Python, libraries and patterns before anything is estimated.
LOADED_BYTES = 130 << 20
# Tiles are made no smaller than this to fit into memory: rows solved at a time keep cores busy.
_LEAST_TILE = 8 << 20
# Rounds after the first one that the coherent coefficients were measured with, the last one twice.
_ROUNDS = 9


@dataclass(frozen=True)
class Size:
    """How large an estimate is.

    Parameters
    ----------
    method : {"coherent", "plain", "other"}
        coherent; row by row with the active-set solver; or one whose time is not known.
    camera : (rows, columns, ...)
        Of the camera, channels last.
    pixels, count : int
        Projector pixels N, patterns K.
    grey : bool
        Whether patterns have grey values, and not only black and white.
    sample_bytes : int
        Of one sample of a frame as it is kept: 1, 2 or 4; 5 once it is binned.
    row_bytes : int
        That a row takes while it is solved, where the method has tiles of its own kind.
    look_bytes : int
        That the look at the photographs takes before.
    tile_bytes : int
        Working memory of rows that are solved at a time.
    windows : tuple of (int, int)
        Half widths of the coherent estimate's windows, which it may need to let light grow.
    """

    method: str
    camera: tuple[int, ...]
    pixels: int
    count: int
    grey: bool
    sample_bytes: int = 1
    row_bytes: int = 0
    look_bytes: int = 0
    tile_bytes: int = TILE_BYTES
    windows: tuple[tuple[int, int], ...] = ()

    @property
    def rows(self) -> int:
        """Camera samples M."""
        return math.prod(self.camera)

    @property
    def kind(self) -> str:
        """Whose coefficients tell what it takes."""
        if self.method == "coherent":
            return "growing" if self._spacing > 1 else "coherent"
        return "plain"

    @property
    def _spacing(self) -> int:
        """Of the camera pixels that look everywhere."""
        return spacings(self.camera, self.pixels, self.windows)[0]

    @property
    def solved_bytes(self) -> int:
        """What one row takes while it is solved."""
        other = self.method == "other"
        return self.row_bytes if other else _row_bytes(self.kind, self.count, self.pixels)

    @property
    def tile_rows(self) -> int:
        """Rows that are solved at a time."""
        return max(1, self.tile_bytes // max(1, self.solved_bytes))

    def within(self, most: int) -> Size:
        """The same by smaller tiles, as far as that helps to take no more than `most` bytes."""
        size = self
        while size.memory > most and size.tile_bytes > _LEAST_TILE:
            size = replace(size, tile_bytes=size.tile_bytes // 2)
        return size

    @property
    def memory(self) -> int:
        """Peak of memory in bytes."""
        kind = self.kind
        terms = memory_terms(kind, self.rows, self.pixels, self.count, self.grey)
        terms["tile"] = min(self.rows * self.solved_bytes, self.tile_bytes)
        told = COEFFICIENTS[kind]["bytes"]
        samples = self.rows * self.count * (self.sample_bytes - 1) - self.temporary
        solving = sum(told[name] * terms[name] for name in told) + samples
        if self.method == "other":
            solving += terms["tile"]
        return int(LOADED_BYTES + max(solving, self.look_bytes))

    @property
    def temporary(self) -> int:
        """Bytes of temporary files, where samples are too many for memory."""
        size = self.rows * self.count * self.sample_bytes
        return size if size > SCRATCH_MEMORY_BYTES else 0

    def seconds(self, cores: int) -> float | None:
        """Time on so many cores; None where it is not known."""
        if self.method == "other":
            return None
        terms = time_terms(self.kind, self.rows, self.pixels, self.count, self.grey)
        if self.kind == "growing":
            looking = _looking(self._spacing) / _looking(SPACINGS[0][0])
            terms |= {name: looking * terms[name] for name in terms if "entry" in name}
        told = COEFFICIENTS[self.kind]["seconds"]
        return sum(told[name] * terms[name] for name in told) / cores


def _looking(spacing: int) -> float:
    """Share of the rows that look everywhere where light grows."""
    return 1 / spacing**2 + _UNEXPLAINED


def coherent_row_bytes(count: int, candidates: int = 250) -> int:
    """What a row of the coherent estimate takes while it is solved."""
    # Samples and expected ones twice, and candidates with what is found of them.
    return 32 * (count + UNSEEN) + 32 * candidates


def _row_bytes(kind: str, count: int, pixels: int) -> int:
    """What a row takes while it is solved."""
    return ActiveSet().row_bytes(count, pixels) if kind == "plain" else coherent_row_bytes(count)


def memory_terms(kind: str, rows: int, pixels: int, count: int, grey: bool) -> dict[str, float]:
    """What memory grows with."""
    row_bytes = _row_bytes(kind, count, pixels)
    values = pixels * (count if kind == "plain" else count + UNSEEN)
    return {
        "pixel": pixels,
        "value": values,
        "grey value": pixels * count * grey,
        "tile": min(rows * row_bytes, TILE_BYTES),
        "row": rows,
        "sample": rows * count,
    }


def time_terms(kind: str, rows: int, pixels: int, count: int, grey: bool) -> dict[str, float]:
    """What time grows with."""
    others = {"row": rows, "sample": rows * count, "grey entry": rows * pixels * count * grey}
    if kind != "plain":
        return {"value": pixels * (count + UNSEEN), "entry": rows * pixels, **others}
    return {"entry": rows * pixels * count, **others}


def first_round_cost(rows: int, pixels: int, count: int, grey: bool) -> float:
    """What the first round of a coherent estimate, which looks at every pixel, takes.

    In rounds of those that come after it.
    """
    terms = time_terms("coherent", rows, pixels, count, grey)
    told = COEFFICIENTS["coherent"]["seconds"]
    whole = sum(told[name] * terms[name] for name in told)
    first = sum(told[name] * terms[name] for name in told if "entry" in name)
    return _ROUNDS * first / (whole - first)
