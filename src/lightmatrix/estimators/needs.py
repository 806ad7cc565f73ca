"""What an estimate will take, told before it starts, and what would take less."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import CutFrames
from lightmatrix.errors import InputError
from lightmatrix.estimators.costs import Size
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.resources.memory import available_bytes

# The checks look at so many levels of the photographs at most, each taking so many bytes.
_LOOKED_LEVELS, _LOOK_BYTES = 48 << 20, 12
# What is proposed takes no more than this share of the free memory, and this many seconds.
_SHARE, _PATIENCE = 0.8, 3600.0
_BLOCKS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32)
# Crops are proposed in steps of sixteen pixels.
_STEP = 16


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
        cores = usual_threads()
        return "; ".join(
            f"{words} takes {_words(size.memory, size.seconds(cores))}"
            for words, size in self.options
        )

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
    *,
    windows: tuple[tuple[int, int], ...] = (),
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
    windows : tuple of (int, int)
        Of "coherent", half widths of the windows of its rounds.
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
        capture.camera_shape,
        capture.patterns.pixels,
        capture.count,
        isinstance(capture.patterns, ImagePatterns) and capture.patterns.as_bits() is None,
        5 if binned else capture.frames.dtype.itemsize,
        row_bytes,
        _LOOK_BYTES * min(math.prod(capture.frames.shape) * capture.count, _LOOKED_LEVELS),
        windows=windows,
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
    rows, cols, *channels = size.camera
    for block in _BLOCKS:
        binned = (-(-rows // block), -(-cols // block), *channels)
        if fine(other := replace(size, camera=binned, sample_bytes=5)):
            yield f"--bin-camera {_block(camera, block)}", other
            break
    # Of the same outline, around the middle.
    for step in range(1, 16):
        share = 2 ** (-step / 2)
        part = [max(1, int(side * share)) // _STEP * _STEP for side in (rows, cols)]
        other = replace(size, camera=(*part, *channels))
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
        binned = (-(-rows // most), -(-cols // most), *channels)
        other = replace(size, camera=binned, pixels=pixels, grey=True, sample_bytes=5)
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
