"""The memory and time that an estimate will take, and settings that take less."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.frames import CutFrames
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.cost_model import EstimateSize
from lightmatrix.estimators.machine_speed import slowness
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.resources.memory import available_bytes
from lightmatrix.resources.threads import core_threads

# The check of the photographs reads at most this many levels of them (`_MOST_LEVELS` in
# `diagnosis/survey.py`), and takes this many bytes of memory for each.
_CHECKED_LEVELS, _CHECK_BYTES = 48 << 20, 12
# Settings are proposed if they take at most this share of the free memory and this many seconds.
# Chosen by hand: the estimate of the memory may be too low, and an hour is a bearable wait.
_SHARE, _PATIENCE = 0.8, 3600.0
# Longer times, in seconds, are worth a measurement of the machine's speed, which takes a tenth of a
# second. Chosen by hand.
_BRIEF = 15.0
# Bin sizes that are tried for a proposal, in pixels of the present bins.
_BLOCKS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32)
# Sides and corners of proposed crops are multiples of this many pixels, so that they are easy to
# type.
_CROP_STEP = 16


@dataclass(frozen=True)
class ResourceEstimate:
    """The memory and time that an estimate will take, and settings that take less.

    Parameters
    ----------
    size : EstimateSize
        How large the estimate is.
    memory, temporary : int
        Bytes of memory at its peak, and of temporary files.
    seconds : float, optional
        Rough time; None for methods whose time is not known.
    available : int
        Bytes of memory that the estimate may take.
    options : tuple of (str, EstimateSize)
        Command-line options that take less; empty unless the estimate is too large or too slow.
    limited : bool
        Whether a memory limit, and not the free memory, says what is available.
    workers : int
        Processes that take this memory together.
    slowness : float
        How many times as long this machine takes as the one that times were measured on; measured
        only for long estimates.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> resources = lm.estimate_resources(capture)
    >>> resources.fits, resources.memory < 2**30, resources.options
    (True, True, ())
    """

    size: EstimateSize
    memory: int
    temporary: int
    seconds: float | None
    available: int
    options: tuple[tuple[str, EstimateSize], ...] = ()
    limited: bool = False
    workers: int = 1
    slowness: float = 1.0

    @property
    def fits(self) -> bool:
        """Whether there is enough memory."""
        return self.memory <= self.available

    @property
    def coherent(self) -> bool:
        """Whether camera pixels learn from their neighbours, unless photographs speak against."""
        return self.size.method == "coherent"

    def __str__(self) -> str:
        disk = f" and {_gigabytes(self.temporary)} of temporary files" if self.temporary else ""
        shared = f" ({self.workers} workers)" if self.workers > 1 else ""
        return _memory_and_time(self.memory, self.seconds) + shared + disk

    @property
    def advice(self) -> str:
        """The options in words; empty if there are none."""
        return "; ".join(
            f"{words} takes {_memory_and_time(size.memory, _seconds(size, self.slowness))}"
            for words, size in self.options
        )

    def check(self) -> None:
        """Refuse an estimate that does not fit into memory.

        Raises
        ------
        InputError
            Saying how much memory it takes, how much there is, and what would fit.
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
        return {
            "memory_bytes": self.memory,
            "temporary_bytes": self.temporary,
            "seconds": self.seconds,
            "available_bytes": self.available,
            "fits": self.fits,
            "workers": self.workers,
            "options": [
                {
                    "option": words,
                    "memory_bytes": size.memory,
                    "seconds": _seconds(size, self.slowness),
                }
                for words, size in self.options
            ],
        }


def estimate_resources(
    capture: Capture | str | Path, settings: EstimateSettings | None = None
) -> ResourceEstimate:
    """Estimate the memory and time that an estimate will take, and what would take less.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, or a capture folder, of which only the first frame is read.
    settings : EstimateSettings, optional
        The settings of the estimate. None: the default settings.

    Returns
    -------
    ResourceEstimate
        Memory is right within a factor of about 1.3 where camera pixels learn from their
        neighbours, and 1.8 row by row. Time is right within about 1.3; below 15 s only on machines
        like that of `cost_model`. For the workers of a cluster it is the memory of each.

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
    size = _size(capture, settings)
    seconds, available, slow = _seconds(size), available_bytes(), 1.0
    limit, workers = settings.memory_limit, settings.workers or 1
    # The free memory and the speed of this machine say nothing about the machines of a cluster.
    elsewhere = settings.cluster is not None
    if seconds is not None and seconds > _BRIEF and not elsewhere:
        slow = slowness()
        seconds *= slow
    limited = limit is not None and (elsewhere or limit < available)
    if limit is not None:
        available = limit if elsewhere else min(limit, available)
        size = size.within(available // workers)
    elif elsewhere:
        available = size.memory
    memory = workers * size.memory
    fine = memory <= available and (seconds is None or seconds <= _PATIENCE)
    options = () if fine else tuple(_options(capture, size, available // workers, slow))
    temporary = workers * size.temporary
    return ResourceEstimate(
        size, memory, temporary, seconds, available, options, limited, workers, slow
    )


def _seconds(size: EstimateSize, slow: float = 1.0) -> float | None:
    """Time on the threads of the core; None if it is not known."""
    seconds = size.seconds(core_threads())
    return None if seconds is None else slow * seconds


def _size(capture: Capture, settings: EstimateSettings) -> EstimateSize:
    method, row_bytes = "other", 0
    if settings.is_coherent(capture):
        method = "coherent"
    elif settings.solver == "active-set" and not settings.multi_scale:
        method = "plain"
    else:
        row_bytes = settings.row_solver.row_bytes(capture.count, capture.patterns.pixels)
    patterns, frames = capture.patterns, capture.frames
    return EstimateSize(
        method,
        capture.camera_shape,
        patterns.pixels,
        capture.count,
        isinstance(patterns, ImagePatterns) and patterns.as_bits() is None,
        5 if capture.bin_camera != (1, 1) else frames.dtype.itemsize,
        row_bytes,
        _CHECK_BYTES * min(math.prod(frames.shape) * capture.count, _CHECKED_LEVELS),
        windows=CoherentEstimator.windows,
        striped=method == "coherent" and stripes_of(patterns) is not None,
    )


def _options(
    capture: Capture, size: EstimateSize, available: int, slow: float
) -> Iterator[tuple[str, EstimateSize]]:
    """Options that make the estimate fit: of each kind the one that loses least."""

    def fine(other: EstimateSize) -> bool:
        seconds = _seconds(other, slow)
        patient = seconds is None or seconds <= _PATIENCE
        return patient and other.memory <= _SHARE * available

    camera, projector = capture.bin_camera, capture.bin_projector
    rows, cols, *channels = size.camera
    for block in _BLOCKS:
        binned = (-(-rows // block), -(-cols // block), *channels)
        if fine(other := replace(size, camera=binned, sample_bytes=5)):
            yield f"--bin-camera {_block(camera, block)}", other
            break
    # Crops around the middle of the image, with its proportions.
    for step in range(1, 16):
        share = 2 ** (-step / 2)
        part = [max(1, int(side * share)) // _CROP_STEP * _CROP_STEP for side in (rows, cols)]
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
    # Both together, with camera bins that leave about twice as many camera samples as projector
    # pixels.
    for block in _BLOCKS:
        pixels = math.prod(-(-side // block) for side in capture.projector_shape)
        most = max(2, math.ceil(math.sqrt(size.rows / max(1, 2 * pixels))))
        binned = (-(-rows // most), -(-cols // most), *channels)
        other = replace(size, camera=binned, pixels=pixels, grey=True, sample_bytes=5)
        if fine(other):
            both = f"--bin-camera {_block(camera, most)} --bin-projector"
            yield f"{both} {_block(projector, block)}", other
            break


def _block(present: tuple[int, int], times: int) -> str:
    """A bin `times` as large as the present one, as the command line writes it."""
    rows, cols = present[0] * times, present[1] * times
    return f"{rows}" if rows == cols else f"{rows}x{cols}"


def _rectangle(capture: Capture, part: list[int]) -> str:
    """A rectangle of `part` (rows, columns) of bins around the middle, as `--crop` writes it."""
    whole, blocks = capture.frames.shape[:2], capture.bin_camera
    shape = [min(side * block, most) for side, block, most in zip(part, blocks, whole, strict=True)]
    corner = [
        (most - side) // 2 // _CROP_STEP * _CROP_STEP
        for most, side in zip(whole, shape, strict=True)
    ]
    if isinstance(capture.frames, CutFrames):
        first = capture.frames.region.corner
        corner = [own + before for own, before in zip(corner, first, strict=True)]
    return f"{corner[0]},{corner[1]}:{shape[0]}x{shape[1]}"


def _memory_and_time(memory: int, seconds: float | None) -> str:
    return f"about {_gigabytes(memory)}" + ("" if seconds is None else f" and {_time(seconds)}")


def _time(seconds: float) -> str:
    """A time in one unit, without digits that the estimate does not support."""
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
