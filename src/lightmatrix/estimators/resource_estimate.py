"""The memory that an estimate takes at most, and the order of magnitude of its time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_solver import coherent_row_bytes
from lightmatrix.estimators.coherent.schedule import GROWTH, spacings
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.work import TILE_BYTES
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.resources.disk import SCRATCH_MEMORY_BYTES
from lightmatrix.resources.memory import available_bytes
from lightmatrix.resources.threads import core_threads


@dataclass(frozen=True)
class _Size:
    """How large an estimate is."""

    # The camera's shape, channels last; projector pixels; patterns.
    camera: tuple[int, ...]
    pixels: int
    count: int
    grey: bool
    coherent: bool
    striped: bool
    # Bytes of one row while it is solved, and whether the solver is the active set.
    row_bytes: int
    active_set: bool
    # Bytes of one kept sample of a frame: 1, 2 or 4; 5 once it is binned.
    sample_bytes: int
    tile_bytes: int = TILE_BYTES

    @property
    def rows(self) -> int:
        """Camera samples M."""
        return math.prod(self.camera)

    @property
    def seed_spacing(self) -> int:
        """Camera pixels between those that search all projector pixels."""
        return spacings(self.camera, self.pixels, CoherentEstimator.windows)[0]

    @property
    def tile_rows(self) -> int:
        """Rows of one tile."""
        return max(1, self.tile_bytes // max(1, self.row_bytes))

    @property
    def temporary(self) -> int:
        """Bytes of temporary files, which hold samples that are too many for memory."""
        size = self.rows * self.count * self.sample_bytes
        return size if size > SCRATCH_MEMORY_BYTES else 0

    @property
    def memory(self) -> int:
        """Bytes of memory at its peak."""
        # Bytes of each projector pixel (halos, notes of threads), of each value of a pattern, the
        # pixels and spots under it included, and of grey values besides; of each row (entries
        # before and after a round), and of each camera sample (its level, value and clip state).
        # `python -m benchmarks.resource_estimate` measures that no estimate takes more.
        pixel, value, grey, row, sample = 100, 19, 28, 400, 9
        values = self.pixels * self.count
        if self.coherent:
            pixel, value, grey, row, sample = 2700, 35, 26, 1500, 6
            if self.seed_spacing > GROWTH.near_seeds:
                # Where light grows from few seeds, spots are kept in half precision.
                pixel, value, grey, row, sample = 1700, 13, 12, 100, 12
            # 64 more patterns were never shown.
            values = self.pixels * (self.count + 64)
        elif self.active_set:
            # The active set keeps this many values of patterns and no more.
            values = min(values, 1 << 25)
        # Stripes tell places less apart, so that coherent rows have more entries.
        row += 1400 * (self.coherent and self.striped)
        # The active set takes less than half of the bytes that it may take of each row.
        share = 0.5 if self.active_set else 1.0
        solving = (
            pixel * self.pixels
            + value * values
            + grey * self.pixels * self.count * self.grey
            + row * self.rows
            + (sample + self.sample_bytes - 1) * self.rows * self.count
            - self.temporary
            + share * min(self.rows * self.row_bytes, self.tile_bytes)
            # The regression of what the rig did takes up to 320,000 samples and their margins, and
            # changes 64 MiB of patterns at a time.
            + self.coherent
            * (300 * min(self.rows * self.count, 640_000) + 20 * min(values, 1 << 24))
        )
        # The check of the photographs reads at most 48 M levels, and takes 12 bytes for each.
        checking = 12 * min(self.rows * self.count, 48 << 20)
        # Python and its libraries take 170 MiB.
        return int((170 << 20) + max(solving, checking))

    @property
    def seconds(self) -> float | None:
        """The operations over a billion of each core a second; None where they are not known."""
        if self.coherent:
            # Of all rows but seeds, 0.3 % search because the light that grew onto them is wrong.
            spacing = self.seed_spacing
            searching = 1.0 if spacing == 1 else spacing**-2 + 0.003
            # Ten rounds on 250 candidates, after a search of all pixels and spots.
            each = 10 * 250 * (self.count + 64) + 20 * searching * self.pixels
        elif self.active_set:
            # One operation handles 64 bits, or two grey values.
            each = 300 * self.count + self.pixels * self.count / (2 if self.grey else 64)
        else:
            return None
        # Python takes two seconds to start and to check.
        return 2 + self.rows * each / 1e9 / core_threads()


@dataclass(frozen=True)
class ResourceEstimate:
    """The memory that an estimate takes at most, and the order of magnitude of its time.

    Parameters
    ----------
    memory, temporary : int
        Bytes of memory at its peak, and of temporary files.
    seconds : float, optional
        Order of magnitude of the time, from a count of operations; None where it is not known.
    available : int
        Bytes of memory that the estimate may take.
    tile_rows : int
        Camera samples that are solved at a time.
    coherent : bool
        Whether camera pixels learn from their neighbours, unless photographs speak against it.
    limited : bool
        Whether a memory limit, and not the free memory, says what is available.
    workers : int
        Processes that take this memory together.
    advice : str
        What would fit, if this does not.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> resources = lm.estimate_resources(capture)
    >>> resources.fits, resources.memory < 2**30
    (True, True)
    """

    memory: int
    temporary: int
    seconds: float | None
    available: int
    tile_rows: int
    coherent: bool
    limited: bool = False
    workers: int = 1
    advice: str = ""

    @property
    def fits(self) -> bool:
        """Whether there is enough memory."""
        return self.memory <= self.available

    def __str__(self) -> str:
        time = "" if self.seconds is None else f", and {_time(self.seconds)}"
        disk = f", {_gigabytes(self.temporary)} of temporary files" if self.temporary else ""
        shared = f" ({self.workers} workers)" if self.workers > 1 else ""
        return f"up to {_gigabytes(self.memory)} of memory{shared}{disk}{time}"

    def check(self) -> None:
        """Refuse an estimate that does not fit into memory.

        Raises
        ------
        InputError
            Saying how much memory it takes, how much there is, and what would fit.
        """
        if not self.fits:
            raise InputError(
                f"the estimate takes up to {_gigabytes(self.memory)} of memory, "
                f"{_gigabytes(self.available)} are {'allowed' if self.limited else 'free'}",
                hint=self.advice,
            )

    def as_dict(self) -> dict[str, Any]:
        """The same, JSON-ready."""
        return {
            "memory_bytes": self.memory,
            "temporary_bytes": self.temporary,
            "seconds": self.seconds,
            "available_bytes": self.available,
            "fits": self.fits,
            "workers": self.workers,
        }


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
    size = _Size(
        capture.camera_shape,
        patterns.pixels,
        capture.count,
        isinstance(patterns, ImagePatterns) and patterns.as_bits() is None,
        coherent,
        coherent and stripes_of(patterns) is not None,
        coherent_row_bytes(capture.count) if coherent else row_bytes,
        settings.solver == "active-set" and not settings.multi_scale,
        5 if capture.bin_camera != (1, 1) else capture.frames.dtype.itemsize,
    )
    limit, workers = settings.memory_limit, settings.workers or 1
    # The free memory of this machine says nothing about the machines of a cluster.
    elsewhere = settings.cluster is not None
    free = size.memory if elsewhere else available_bytes()
    available = free if limit is None else limit if elsewhere else min(limit, free)
    if limit is not None:
        # Tiles of less than 8 MiB would leave cores without work.
        while workers * size.memory > available and size.tile_bytes > 8 << 20:
            size = replace(size, tile_bytes=size.tile_bytes // 2)
    fits = workers * size.memory <= available
    return ResourceEstimate(
        workers * size.memory,
        workers * size.temporary,
        size.seconds,
        available,
        size.tile_rows,
        coherent,
        limit is not None and available == limit,
        workers,
        "" if fits else _advice(capture, size, available // workers),
    )


def _advice(capture: Capture, size: _Size, available: int) -> str:
    """The smallest bins of the camera, or of the projector, with which the estimate fits."""

    def coarse(side: str, block: int) -> _Size:
        if side == "camera":
            rows, cols, *channels = size.camera
            camera = (-(-rows // block), -(-cols // block), *channels)
            return replace(size, camera=camera, sample_bytes=5)
        pixels = math.prod(-(-length // block) for length in capture.projector_shape)
        return replace(size, pixels=pixels, grey=True)

    fitting = []
    for side in ("camera", "projector"):
        blocks = (block for block in range(2, 33) if coarse(side, block).memory <= available)
        if block := next(blocks, None):
            down, right = (block * length for length in getattr(capture, f"bin_{side}"))
            fitting.append(f"bin_{side}=({down}, {right})")
    if not fitting:
        return "use a machine with more memory, or bin camera and projector"
    return f"{' or '.join(fitting)} fits; or cut the camera's images to the part that matters"


def _time(seconds: float) -> str:
    """The order of magnitude of a time."""
    words = ((10, "seconds"), (100, "about a minute"), (1500, "some minutes"))
    for limit, word in (*words, (7200, "about an hour"), (86400, "hours")):
        if seconds < limit:
            return word
    return "days"


def _gigabytes(size: int) -> str:
    gigabytes = size / 2**30
    return f"{gigabytes:.2g} GiB" if gigabytes < 10 else f"{gigabytes:,.0f} GiB"
