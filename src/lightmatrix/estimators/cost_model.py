"""How much memory and time an estimate takes, by its size.

`python -m benchmarks.resource_estimate` measures the coefficients: it makes procedural captures of
many sizes, runs `lightmatrix estimate` on each with all checks, and fits `COEFFICIENTS` to the
largest resident set and the processor time of that process. Of these 35 estimates (AMD EPYC with
AVX-512, 2 cores, 2026-11) none takes more memory than is said; coherent ones take at least .84 of
it, others at least .55. Times are right within 1.3. (Large frames were fitted with fewer seeds, and
measured again with those of today.) On other machines the time is in proportion to
`machine_speed.slowness`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from lightmatrix.estimators.coherent.neighbourhood import PSEUDO_SAMPLES
from lightmatrix.estimators.coherent.schedule import GROWTH, spacings
from lightmatrix.estimators.work import TILE_BYTES
from lightmatrix.resources.disk import SCRATCH_MEMORY_BYTES
from lightmatrix.solvers.active_set import ActiveSet

# Bytes per unit of `memory_terms` and seconds of one core per unit of `time_terms`, by the method.
# "growing" is the coherent estimate of large frames, in which few rows search all projector pixels.
# An entry is a projector pixel that a row searches, or solves by itself; the start is what every
# command takes, and most checks.
COEFFICIENTS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "coherent": {
        "bytes": {
            "pixel": 2700,
            "value": 34.5,
            "grey value": 26,
            "tile": 0.22,
            "row": 1500,
            "sample": 5,
        },
        "seconds": {
            "start": 1.6,
            "value": 3.6e-7,
            "entry": 1.96e-8,
            "row": 1.23e-4,
            "sample": 1.56e-6,
            "grey entry": 2.8e-10,
        },
    },
    "growing": {
        "bytes": {
            "pixel": 1650,
            "value": 12.5,
            "grey value": 11.5,
            "tile": 0.45,
            "row": 100,
            "sample": 11.4,
        },
        "seconds": {
            "start": 4.3,
            "pixel": 3.6e-5,
            "entry": 2.5e-8,
            "row": 5e-6,
            "sample": 1.66e-6,
        },
    },
    "plain": {
        "bytes": {
            "pixel": 100,
            "value": 18.5,
            "grey value": 27.5,
            "tile": 0.225,
            "row": 380,
            "sample": 8.2,
        },
        "seconds": {
            "start": 1.5,
            "pixel": 1.45e-5,
            "value": 9e-8,
            "entry": 9e-12,
            "row": 2.3e-6,
            "sample": 3e-7,
            "grey entry": 3.64e-10,
        },
    },
}
# The memory of an estimate row by row grows with the values of the patterns (projector pixels times
# patterns) up to this number, and no further. Measured with the active set on up to 2^28 values.
_MOST_VALUES = 1 << 25
# Stripes tell places less apart, so that coherent rows have more entries. Each row takes this many
# bytes more, and the estimate this many times as long. Measured on the board of docs/scale.md.
_STRIPED_ROW_BYTES, _STRIPED_TIME = 1400, 1.5
# Share of the rows that search all projector pixels although they are no seeds, because the light
# that grew onto them does not explain their samples. Estimated by hand.
_UNEXPLAINED_SHARE = 0.003
# Bytes that Python, the libraries and the patterns take before the estimate begins.
LOADED_BYTES = 170 << 20
# Bytes of the smallest tile that a memory limit may lead to. Chosen by hand: rows that are solved
# together keep all cores busy.
_LEAST_TILE_BYTES = 8 << 20
# Rounds after the first one in the measurements of "coherent": eight, the last of them twice.
_ROUNDS = 9


@dataclass(frozen=True)
class EstimateSize:
    """How large an estimate is, and the memory and time that this takes."""

    # "coherent", "plain" (row by row with the active set), or "other", of unknown time.
    method: str
    # The camera's shape, channels last.
    camera: tuple[int, ...]
    # Projector pixels of each of the `count` patterns, `grey` or only black and white.
    pixels: int
    count: int
    grey: bool
    # Bytes of one kept sample of a frame: 1, 2 or 4; 5 once it is binned.
    sample_bytes: int = 1
    # Bytes of a row by an "other" method.
    row_bytes: int = 0
    # Memory that the check of the photographs takes before the estimate.
    check_bytes: int = 0
    tile_bytes: int = TILE_BYTES
    # Windows of the coherent estimate's rounds.
    windows: tuple[tuple[int, int], ...] = ()
    # Whether a coherent estimate is made from stripes: each pattern varies along one axis only.
    striped: bool = False

    @property
    def rows(self) -> int:
        """Camera samples M."""
        return math.prod(self.camera)

    @property
    def kind(self) -> str:
        """The key of the coefficients that apply."""
        if self.method == "coherent":
            return "growing" if self._seed_spacing > GROWTH.near_seeds else "coherent"
        return "plain"

    @property
    def _seed_spacing(self) -> int:
        """Camera pixels between those that search all projector pixels."""
        return spacings(self.camera, self.pixels, self.windows)[0]

    @property
    def searching(self) -> float:
        """Share of the rows that search all projector pixels."""
        spacing = 1 if self.method != "coherent" else self._seed_spacing
        return 1.0 if spacing == 1 else 1 / spacing**2 + _UNEXPLAINED_SHARE

    @property
    def solved_row_bytes(self) -> int:
        """Bytes that one row takes while it is solved."""
        other = self.method == "other"
        return self.row_bytes if other else _row_bytes(self.kind, self.count, self.pixels)

    @property
    def tile_rows(self) -> int:
        """Rows of one tile."""
        return max(1, self.tile_bytes // max(1, self.solved_row_bytes))

    def within(self, limit: int) -> EstimateSize:
        """The same estimate in smaller tiles, as far as these bring it below `limit` bytes."""
        size = self
        while size.memory > limit and size.tile_bytes > _LEAST_TILE_BYTES:
            size = replace(size, tile_bytes=size.tile_bytes // 2)
        return size

    @property
    def memory(self) -> int:
        """Bytes of memory at its peak."""
        terms = memory_terms(self.kind, self.rows, self.pixels, self.count, self.grey)
        terms["tile"] = min(self.rows * self.solved_row_bytes, self.tile_bytes)
        if self.method == "other":
            terms["value"] = self.pixels * self.count
        coefficients = COEFFICIENTS[self.kind]["bytes"]
        samples = self.rows * self.count * (self.sample_bytes - 1) - self.temporary
        solving = sum(coefficients[name] * terms[name] for name in coefficients) + samples
        if self.method == "other":
            solving += terms["tile"]
        if self.striped:
            solving += _STRIPED_ROW_BYTES * self.rows
        return int(LOADED_BYTES + max(solving, self.check_bytes))

    @property
    def temporary(self) -> int:
        """Bytes of temporary files, which hold samples that are too many for memory."""
        size = self.rows * self.count * self.sample_bytes
        return size if size > SCRATCH_MEMORY_BYTES else 0

    def seconds(self, cores: int) -> float | None:
        """Time on some cores; None where it is not known."""
        if self.method == "other":
            return None
        size = self.rows, self.pixels, self.count, self.grey
        terms = time_terms(self.kind, *size, self.searching)
        coefficients = COEFFICIENTS[self.kind]["seconds"]
        start = coefficients["start"]
        whole = sum(coefficients[name] * terms[name] for name in coefficients)
        times = _STRIPED_TIME if self.striped else 1.0
        # Python starts on one core.
        return start + times * (whole - start) / cores


def coherent_row_bytes(count: int, candidates: int = 250) -> int:
    """Bytes that a row of the coherent estimate takes while it is solved."""
    # Samples and pseudo-samples twice, and the candidates with their coefficients.
    return 32 * (count + PSEUDO_SAMPLES.unseen) + 32 * candidates


def _row_bytes(kind: str, count: int, pixels: int) -> int:
    return ActiveSet().row_bytes(count, pixels) if kind == "plain" else coherent_row_bytes(count)


def memory_terms(kind: str, rows: int, pixels: int, count: int, grey: bool) -> dict[str, float]:
    """The quantities that the peak of memory is a sum of."""
    row_bytes = _row_bytes(kind, count, pixels)
    values = pixels * (count + PSEUDO_SAMPLES.unseen)
    if kind == "plain":
        values = min(pixels * count, _MOST_VALUES)
    return {
        "pixel": pixels,
        "value": values,
        "grey value": pixels * count * grey,
        "tile": min(rows * row_bytes, TILE_BYTES),
        "row": rows,
        "sample": rows * count,
    }


def time_terms(
    kind: str, rows: int, pixels: int, count: int, grey: bool, searching: float = 1.0
) -> dict[str, float]:
    """The quantities that the time is a sum of; some of the rows are `searching`."""
    entries, plain = rows * searching * pixels, kind == "plain"
    return {
        "start": 1.0,
        "pixel": pixels,
        "value": pixels * (count if plain else count + PSEUDO_SAMPLES.unseen),
        "entry": entries * (count if plain else 1),
        "row": rows,
        "sample": rows * count,
        "grey entry": entries * count * grey,
    }


def first_round_cost(rows: int, pixels: int, count: int, grey: bool) -> float:
    """Time of a coherent estimate's first round, over all projector pixels, in later rounds."""
    terms = time_terms("coherent", rows, pixels, count, grey)
    coefficients = COEFFICIENTS["coherent"]["seconds"]
    whole = sum(coefficients[name] * terms[name] for name in coefficients if name != "start")
    first = sum(coefficients[name] * terms[name] for name in coefficients if "entry" in name)
    return _ROUNDS * first / (whole - first)
