"""What an estimate will take of memory and time, told before it starts, and what would take less.

The numbers come from measurements: `python -m benchmarks.needs` makes procedural captures of many
sizes, estimates each in a process of its own on one core (peak of resident memory beyond what is
loaded anyway, CPU seconds), and fits `COEFFICIENTS` to them. They hold within a factor of about
1.5 in memory and 2 in time on the machine that they were measured on (AMD EPYC, 2026-11).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import CutFrames
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.neighbourhood import UNSEEN
from lightmatrix.estimators.coherent.stages import is_large
from lightmatrix.estimators.join import TILE_BYTES
from lightmatrix.files.memory import available_bytes
from lightmatrix.files.scratch import MEMORY_BYTES
from lightmatrix.patterns.pattern_set import ImagePatterns
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
        "seconds": {"row": 8.8e-6, "sample": 2.2e-7, "entry": 5.7e-11, "grey entry": 8.3e-10},
    },
}
# Python, libraries and patterns before anything is estimated.
LOADED_BYTES = 130 << 20
# The checks look at so many levels of the photographs at most, each taking so many bytes.
_LOOKED_LEVELS, _LOOK_BYTES = 48 << 20, 12
# What is proposed takes no more than this share of the free memory, and this many seconds.
_SHARE, _PATIENCE = 0.8, 3600.0
_BLOCKS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32)
# Crops are proposed in steps of sixteen pixels.
_STEP = 16
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
    rows, pixels, count : int
        Camera samples M, projector pixels N, patterns K.
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
    """

    method: str
    rows: int
    pixels: int
    count: int
    grey: bool
    sample_bytes: int = 1
    row_bytes: int = 0
    look_bytes: int = 0
    tile_bytes: int = TILE_BYTES

    @property
    def kind(self) -> str:
        """Whose coefficients tell what it takes."""
        if self.method == "coherent":
            return "growing" if is_large(self.rows, self.pixels) else "coherent"
        return "plain"

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
        return size if size > MEMORY_BYTES else 0

    def seconds(self, cores: int) -> float | None:
        """Time on so many cores; None where it is not known."""
        if self.method == "other":
            return None
        terms = time_terms(self.kind, self.rows, self.pixels, self.count, self.grey)
        told = COEFFICIENTS[self.kind]["seconds"]
        return sum(told[name] * terms[name] for name in told) / cores

    def __str__(self) -> str:
        return _words(self.memory, self.seconds(usual_threads()))


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


@dataclass(frozen=True)
class Needs:
    """What an estimate will take, and what would take less.

    Parameters
    ----------
    size : Size
        Of the estimate.
    memory, temporary : int
        Bytes of memory at its peak, and of temporary files.
    seconds : float, optional
        Rough time; None for methods whose time is not known.
    available : int
        Bytes of memory that are free.
    options : tuple of (str, Size)
        What takes less, as it is said on the command line; empty where nothing has to.
    limited : bool
        Whether no more than the available memory is allowed, though more may be free.
    workers : int
        Processes that take this memory together.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> needs = lm.needs(capture)
    >>> needs.fits, needs.memory < 2**30, needs.options
    (True, True, ())
    """

    size: Size
    memory: int
    temporary: int
    seconds: float | None
    available: int
    options: tuple[tuple[str, Size], ...] = ()
    limited: bool = False
    workers: int = 1

    @property
    def fits(self) -> bool:
        """Whether there is memory for it."""
        return self.memory <= self.available

    def __str__(self) -> str:
        disk = f" and {_gigabytes(self.temporary)} of temporary files" if self.temporary else ""
        shared = f" ({self.workers} workers)" if self.workers > 1 else ""
        return _words(self.memory, self.seconds) + shared + disk

    @property
    def advice(self) -> str:
        """What takes less, in words; empty where nothing has to."""
        return "; ".join(f"{words} takes {size}" for words, size in self.options)

    def check(self) -> None:
        """Refuse what does not fit into memory.

        Raises
        ------
        InputError
            Saying what it takes, what there is, and what would fit.
        """
        if self.fits:
            return
        size = self.size
        raise InputError(
            f"{size.rows:,} camera samples under {size.count} patterns of {size.pixels:,} projector"
            f" pixels take about {_gigabytes(self.memory)} of memory, "
            f"{_gigabytes(self.available)} are {'allowed' if self.limited else 'free'}",
            hint=self.advice or "use a machine with more memory, or bin camera and projector",
        )

    def as_dict(self) -> dict[str, Any]:
        """The same, JSON-ready."""
        cores = usual_threads()
        return {
            "memory_bytes": self.memory,
            "temporary_bytes": self.temporary,
            "seconds": self.seconds,
            "available_bytes": self.available,
            "fits": self.fits,
            "workers": self.workers,
            "options": [
                {"say": words, "memory_bytes": size.memory, "seconds": size.seconds(cores)}
                for words, size in self.options
            ],
        }


def needs_of(
    capture: Capture,
    method: str,
    row_bytes: int = 0,
    most: int | None = None,
    workers: int = 1,
    elsewhere: bool = False,
) -> Needs:
    """What an estimate from a capture will take, by a method of `Size`; reads no frame.

    Parameters
    ----------
    capture : Capture
    method : {"coherent", "plain", "other"}
    row_bytes : int
        Of "other", what a row takes while it is solved.
    most : int, optional
        Bytes of memory that it may take; None: all that are free.
    workers : int
        Processes on this machine that share this memory, each with the patterns and a tile.
    elsewhere : bool
        Whether it is solved on other machines: what is told is each worker's, and what is free here
        says nothing of it.
    """
    binned = capture.bin_camera != (1, 1)
    size = Size(
        method,
        capture.rows,
        capture.patterns.pixels,
        capture.count,
        isinstance(capture.patterns, ImagePatterns) and capture.patterns.packed_bits() is None,
        5 if binned else capture.frames.dtype.itemsize,
        row_bytes,
        _LOOK_BYTES * min(math.prod(capture.frames.shape) * capture.count, _LOOKED_LEVELS),
    )
    seconds, available = size.seconds(usual_threads()), available_bytes()
    limited = most is not None and (elsewhere or most < available)
    if most is not None:
        available = most if elsewhere else min(most, available)
        size = size.within(available // workers)
    elif elsewhere:
        available = size.memory
    fine = workers * size.memory <= available and (seconds is None or seconds <= _PATIENCE)
    options = () if fine else tuple(_options(capture, size, available // workers))
    taken, temporary = workers * size.memory, workers * size.temporary
    return Needs(size, taken, temporary, seconds, available, options, limited, workers)


def _options(capture: Capture, size: Size, available: int) -> Iterator[tuple[str, Size]]:
    """What takes less, the way that costs least of each kind."""
    cores = usual_threads()

    def fine(other: Size) -> bool:
        seconds = other.seconds(cores)
        patient = seconds is None or seconds <= _PATIENCE
        return patient and other.memory <= _SHARE * available

    camera, projector = capture.bin_camera, capture.bin_projector
    rows, cols = capture.camera_shape[:2]
    channels = size.rows // (rows * cols)
    for block in _BLOCKS:
        binned = -(-rows // block) * -(-cols // block) * channels
        if fine(other := replace(size, rows=binned, sample_bytes=5)):
            yield f"--bin-camera {_block(camera, block)}", other
            break
    # Of the same outline, around the middle.
    for step in range(1, 16):
        share = 2 ** (-step / 2)
        part = [max(1, int(side * share)) // _STEP * _STEP for side in (rows, cols)]
        other = replace(size, rows=math.prod(part) * channels)
        if min(part) > 0 and fine(other):
            yield f"--crop {_rectangle(capture, part)}", other
            break
    for block in _BLOCKS:
        pixels = math.prod(-(-side // block) for side in capture.projector_shape)
        if pixels > 1 and fine(other := replace(size, pixels=pixels, grey=True)):
            yield f"--bin-projector {_block(projector, block)}", other
            break
    if size.grey and fine(other := replace(size, grey=False)):
        yield "patterns of black and white pixels (lightmatrix patterns bernoulli)", other
    # Both sides by what brings them to a like number of pixels.
    for block in _BLOCKS:
        pixels = math.prod(-(-side // block) for side in capture.projector_shape)
        most = max(2, math.ceil(math.sqrt(size.rows / max(1, 2 * pixels))))
        binned = -(-rows // most) * -(-cols // most) * channels
        other = replace(size, rows=binned, pixels=pixels, grey=True, sample_bytes=5)
        if fine(other):
            both = f"--bin-camera {_block(camera, most)} --bin-projector"
            yield f"{both} {_block(projector, block)}", other
            break


def _block(now: tuple[int, int], times: int) -> str:
    """A block so many times as large, as options have it."""
    rows, cols = now[0] * times, now[1] * times
    return f"{rows}" if rows == cols else f"{rows}x{cols}"


def _rectangle(capture: Capture, part: list[int]) -> str:
    """A rectangle of binned pixels around the middle, as `--crop` has it."""
    whole, blocks = capture.frames.shape[:2], capture.bin_camera
    shape = [min(side * block, most) for side, block, most in zip(part, blocks, whole, strict=True)]
    corner = [(most - side) // 2 // _STEP * _STEP for most, side in zip(whole, shape, strict=True)]
    if isinstance(capture.frames, CutFrames):
        first = capture.frames.region.corner
        corner = [own + before for own, before in zip(corner, first, strict=True)]
    return f"{corner[0]},{corner[1]}:{shape[0]}x{shape[1]}"


def usual_threads() -> int:
    """Threads that the compiled core will use."""
    asked = os.environ.get("RAYON_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) else os.cpu_count() or 1


def _words(memory: int, seconds: float | None) -> str:
    return f"about {_gigabytes(memory)}" + ("" if seconds is None else f" and {_time(seconds)}")


def _time(seconds: float) -> str:
    """A rough time: nobody is helped by seconds of hours."""
    if seconds < 10:
        return "a few seconds"
    if seconds < 90:
        return f"{round(seconds, -1):.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    hours = seconds / 3600
    return f"{hours:.0f} h" if hours < 48 else f"{hours / 24:.0f} days"


def _gigabytes(size: int) -> str:
    gigabytes = size / 2**30
    return f"{gigabytes:.2g} GiB" if gigabytes < 10 else f"{gigabytes:,.0f} GiB"
