"""The memory that an estimate takes at most, and the order of magnitude of its time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_solver import coherent_row_bytes, in_parts
from lightmatrix.estimators.coherent.schedule import GROWTH, spacings
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.work import TILE_BYTES
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.reprs import amount
from lightmatrix.resources.memory import SCRATCH_MEMORY_BYTES, available_bytes
from lightmatrix.resources.threads import core_threads


@dataclass(frozen=True)
class ResourceEstimate:
    """The memory that an estimate takes at most, and the order of magnitude of its time."""

    # Bytes of memory at its peak, and of temporary files.
    memory: int
    temporary: int
    # The time by a count of operations; None where it is not known.
    seconds: float | None
    # Bytes of memory that it may take.
    available: int
    # Camera samples that are solved at a time.
    tile_rows: int
    # Whether camera pixels learn from their neighbours, unless photographs speak against it.
    coherent: bool
    # Whether a memory limit, and not the free memory, says what is available.
    limited: bool = False
    # Processes that take this memory together.
    workers: int = 1

    @property
    def fits(self) -> bool:
        """Whether there is enough memory."""
        return self.memory <= self.available

    @property
    def advice(self) -> str:
        """What takes less memory, if this does not fit."""
        advice = (
            "average pixels, such as bin_camera=2 or bin_projector=2; cut the photographs to the "
            "part that matters; or use a machine with more memory"
        )
        return "" if self.fits else advice

    def __str__(self) -> str:
        time = ""
        if self.seconds is not None:
            limits = {10: "seconds", 100: "about a minute", 1500: "some minutes"}
            limits |= {7200: "about an hour", 86400: "hours"}
            time = next((word for limit, word in limits.items() if self.seconds < limit), "days")
            time = f", and {time}"
        disk = f", {amount(self.temporary)} of temporary files" if self.temporary else ""
        shared = f" ({self.workers} workers)" if self.workers > 1 else ""
        return f"up to {amount(self.memory)} of memory{shared}{disk}{time}"

    def check(self) -> None:
        """Refuse an estimate that does not fit into memory, saying what takes less."""
        if not self.fits:
            takes = f"the estimate takes up to {amount(self.memory)} of memory"
            there = f"{amount(self.available)} are {'allowed' if self.limited else 'free'}"
            raise InputError(f"{takes}, {there}", hint=self.advice)

    def as_dict(self) -> dict[str, Any]:
        """The same, JSON-ready."""
        return {
            "memory_bytes": self.memory, "temporary_bytes": self.temporary, "seconds": self.seconds,
            "available_bytes": self.available, "fits": self.fits, "workers": self.workers,
        }  # fmt: skip


def estimate_resources(
    capture: Capture | str | Path, settings: EstimateSettings | None = None
) -> ResourceEstimate:
    """State the memory that an estimate takes at most, and the order of magnitude of its time.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, or a capture folder, of which only the first frame is read.
    settings : EstimateSettings, optional
        The settings of the estimate. None: the default settings.

    Returns
    -------
    ResourceEstimate
        Memory is a bound. The time may be wrong by a factor of three either way; the progress bar
        knows better after the first tiles. For the workers of a cluster it is the memory of each.

    Raises
    ------
    InputError
        If the folder holds no capture.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> lm.estimate_resources(capture).fits
    True
    """
    capture, settings = open_capture(capture), settings or EstimateSettings()
    patterns, coherent = capture.patterns, settings.is_coherent(capture)
    row_bytes = settings.row_solver.row_bytes(capture.count, patterns.pixels)
    if coherent:
        row_bytes = coherent_row_bytes(capture.count)
    active_set = settings.solver == "active-set" and not settings.multi_scale
    # Bytes of one kept sample of a frame: 1, 2 or 4; 5 once it is binned.
    sample_bytes = 5 if capture.bin_camera != (1, 1) else capture.frames.dtype.itemsize
    samples, values = capture.rows * capture.count, patterns.pixels * (capture.count + 64)
    temporary = samples * sample_bytes
    # Temporary files hold samples that are too many for memory.
    temporary *= temporary > SCRATCH_MEMORY_BYTES
    # The regression of what the rig did takes up to 320,000 samples and their margins, and changes
    # 64 MiB of patterns at a time.
    regression = coherent * (300 * min(samples, 640_000) + 20 * min(values, 1 << 24))
    held = _held_bytes(capture, coherent, active_set, sample_bytes) - temporary
    # The check of the photographs reads at most 48 M levels, and takes 12 bytes for each.
    checking = 12 * min(samples, 48 << 20)
    # The active set takes less than half of the bytes that it may take of each row.
    share = 0.5 if active_set else 1.0

    def memory(tile_bytes: int) -> int:
        solving = share * min(capture.rows * row_bytes, tile_bytes) + regression
        if coherent and in_parts(capture):
            # Bytes of the atoms of a square that is searched, of the atoms of rows that are solved,
            # and of the rows of two tiles, 1,700 a row; later of T beside the regression, where a
            # row has 20 to 25 entries and 64 cells, and takes 300 more than in a round. What the
            # estimates of `python -m benchmarks.scale --4k` took decides the factors.
            in_work = (800 << 20) + 2.25 * tile_bytes + min(1700 * capture.rows, 1.1 * tile_bytes)
            solving = max(in_work, 300 * capture.rows + regression)
        # Python and its libraries take 170 MiB.
        return int((170 << 20) + max(held + solving, checking))

    limit, workers, tile_bytes = settings.memory_limit, settings.workers or 1, TILE_BYTES
    # The free memory of this machine says nothing about the machines of a cluster.
    elsewhere = settings.cluster is not None
    free = memory(tile_bytes) if elsewhere else available_bytes()
    available = free if limit is None else limit if elsewhere else min(limit, free)
    # Tiles of less than 8 MiB would leave cores without work.
    while limit is not None and workers * memory(tile_bytes) > available and tile_bytes > 8 << 20:
        tile_bytes //= 2
    return ResourceEstimate(
        workers * memory(tile_bytes), workers * temporary,
        _seconds(capture, coherent) if active_set else None, available,
        max(1, tile_bytes // max(1, row_bytes)), coherent, limit is not None and available == limit,
        workers,
    )  # fmt: skip


def _is_grey(patterns: PatternSet) -> bool:
    return isinstance(patterns, ImagePatterns) and patterns.as_bits() is None


def _seed_spacing(capture: Capture) -> int:
    """Camera pixels between those that search all projector pixels."""
    return spacings(capture.camera_shape, capture.patterns.pixels, CoherentEstimator.windows)[0]


def _held_bytes(capture: Capture, coherent: bool, active_set: bool, sample_bytes: int) -> int:
    """Bytes of memory at the peak of an estimate besides those of its tiles."""
    patterns, rows = capture.patterns, capture.rows
    # Bytes of each projector pixel (halos, notes of threads), of each value of a pattern, the
    # pixels and spots under it included, and of grey values besides; of each row (entries before
    # and after a round), and of each camera sample (its level, value and clip state).
    # `python -m benchmarks.resource_estimate` measures that no estimate takes more.
    pixel, value, grey, row, sample = 100, 19.0, 28, 400, 9
    values = patterns.pixels * capture.count
    if coherent:
        pixel, value, grey, row, sample = 2700, 35, 26, 1500, 6
        if _seed_spacing(capture) > GROWTH.near_seeds:
            # Spots are kept in half precision where estimates spread from few seeds.
            pixel, value, grey, row, sample = 1700, 13, 12, 100, 12
        if in_parts(capture):
            # No atoms are kept, and patterns are as they were given.
            pixel, value, grey, row, sample = 40, 0.125, 8, 270, 1
        # 64 more patterns were never shown.
        values = patterns.pixels * (capture.count + 64)
        # Stripes tell places less apart, so that rows have more entries.
        row += 1400 * (stripes_of(patterns) is not None)
    elif active_set:
        # The active set keeps this many values of patterns and no more.
        values = min(values, 1 << 25)
    size = pixel * patterns.pixels + value * values + row * rows
    size += grey * patterns.pixels * capture.count * _is_grey(patterns)
    size += (sample + sample_bytes - 1) * rows * capture.count
    return int(size)


def _seconds(capture: Capture, coherent: bool) -> float:
    """The operations over a billion of each core a second."""
    count, pixels = capture.count, capture.patterns.pixels
    if coherent:
        # The light that grew onto 0.3 % of all rows but seeds is wrong, so these search too.
        spacing = _seed_spacing(capture)
        searching = 1.0 if spacing == 1 else spacing**-2 + 0.003
        # Ten rounds on 250 candidates, after a search of all pixels and spots.
        each = 10 * 250 * (count + 64) + 20 * searching * pixels
    else:
        # One operation handles 64 bits, or two grey values.
        each = 300 * count + pixels * count / (2 if _is_grey(capture.patterns) else 64)
    # Python takes two seconds to start and to check.
    return 2 + capture.rows * each / 1e9 / core_threads()
