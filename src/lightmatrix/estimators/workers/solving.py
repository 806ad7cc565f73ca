"""What a worker does: it opens an estimate once, and solves and writes tiles of it."""

from __future__ import annotations

import hashlib
import os
import platform
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import PixelFrames
from lightmatrix.errors import ClusterError, InputError, LightMatrixError
from lightmatrix.estimators.needs import usual_threads
from lightmatrix.estimators.steps import SolveTile, Work
from lightmatrix.estimators.workers.travel import unpacked
from lightmatrix.resources.memory import available_bytes
from lightmatrix.store.checkpoint import fingerprint_token
from lightmatrix.store.tiles import Span, read_tile, tile_name, write_tile
from lightmatrix.transport.sparse_rows import SparseRows

# What the estimate is called in the folder of its running results.
JOB = "job.pickle"
# A shared file system may show other machines' files some seconds late.
PATIENCE = 15.0
# Camera samples that are compared, in all frames, where these lie by pixel.
_LOOKED = 64
_THREADS = "RAYON_NUM_THREADS"
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """An estimate that lies in a folder which all workers share.

    Parameters
    ----------
    folder : str
        Of the running results, an absolute path.
    digest : str
        Hash of the file in it that holds the estimate.
    token : str
        Fingerprint of the running results.
    seen : str
        What `look_of` sees of the capture.
    version : str
        Of lightmatrix.
    """

    folder: str
    digest: str
    token: str
    seen: str
    version: str = __version__


@dataclass
class _Bench:
    """The one estimate that a worker has open, and the step of it that it is at."""

    job: Job | None = None
    work: Work | None = None
    step: str = ""
    solve_tile: SolveTile | None = None
    # Tiles take all threads of a worker, and memory for one of them: one at a time.
    lock: threading.Lock = field(default_factory=threading.Lock)

    def clear(self) -> None:
        self.job, self.work, self.step, self.solve_tile = None, None, "", None


_bench = _Bench()


def about(dask_worker: Any) -> dict[str, Any]:
    """What a worker is, JSON-ready: compared with what the client is."""
    # Started by us it is told its threads; by others it has those that Dask knows of.
    os.environ.setdefault(_THREADS, str(dask_worker.state.nthreads))
    return {
        "threads": usual_threads(),
        "versions": versions(),
        "host": platform.node(),
        "process": os.getpid(),
        "available": available_bytes(),
    }


def versions() -> dict[str, str]:
    """Of all that results depend on."""
    return {
        "lightmatrix": __version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def look_of(capture: Capture) -> str:
    """A hash of some of the levels of a capture, which tells whether it is another one."""
    frames = capture.frames
    if isinstance(frames, PixelFrames):
        parts = [frames.levels(0, min(_LOOKED, int(np.prod(frames.shape))))]
    else:
        parts = [frames.read(0), frames.read(frames.count - 1)]
    hasher = hashlib.sha256(capture.patterns.digest.encode())
    for part in parts:
        hasher.update(repr((part.shape, part.dtype.str)).encode())
        hasher.update(np.ascontiguousarray(part).tobytes())
    return hasher.hexdigest()


def look(job: Job) -> None:
    """Whether this worker sees what it will read, and may write where it will write.

    Raises
    ------
    ClusterError
        If not, with what to do.
    """
    folder = Path(job.folder)
    if _patiently(lambda: fingerprint_token(folder)) != job.token:
        raise ClusterError(
            f"does not see the running results in {folder}",
            hint="write the output to a file system that all workers share, by the same path",
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ClusterError(
            f"may not write in {folder}", hint="let workers run as a user who may write there"
        )
    with _bench.lock:
        work = _opened(job)
        try:
            same = look_of(work.capture) == job.seen
        except LightMatrixError as error:
            raise ClusterError(
                f"cannot read the capture: {error.message}",
                hint="put the capture on a file system that all workers share, by the same path",
            ) from error
    if not same:
        raise ClusterError(
            "sees another capture by the path of this one",
            hint="put the capture on a file system that all workers share, by the same path",
        )


def solve(job: Job, step: str, span: Span, before: Mapping[str, list[Span]], threads: int) -> None:
    """Solve a tile and write it where the running results have its place.

    Parameters
    ----------
    job : Job
    step : str
    span : (int, int)
        The rows start..stop of the step.
    before : mapping of str to list of (int, int)
        Tiles of the steps that come before it.
    threads : int
        Of this worker; they are started with its first tile.

    Raises
    ------
    LightMatrixError
        As an estimate in one process.
    """
    if job.version != __version__:
        raise ClusterError(
            f"a worker has lightmatrix {__version__}, this is {job.version}",
            hint="install the same version for all workers",
        )
    with _bench.lock:
        os.environ.setdefault(_THREADS, str(threads))
        work = _opened(job)
        if _bench.step != step or _bench.solve_tile is None:
            _bench.solve_tile = work.begin(step, lambda name: _found(job, name, before[name]))
            _bench.step = step
        rows = _bench.solve_tile(*span)
        write_tile(Path(job.folder) / tile_name(step, span), job.token, rows)


def forget() -> None:
    """Close an estimate that is done."""
    if _bench.lock.acquire(blocking=False):
        try:
            _bench.clear()
        finally:
            _bench.lock.release()


def _opened(job: Job) -> Work:
    if _bench.job != job or _bench.work is None:
        _bench.clear()
        file = Path(job.folder) / JOB
        data = _patiently(lambda: _bytes_of(file, job.digest))
        if data is None:
            raise ClusterError(
                f"does not find the estimate in {file}",
                hint="write the output to a file system that all workers share, by the same path",
            )
        _bench.job, _bench.work = job, unpacked(data)
    return _bench.work


def _bytes_of(file: Path, digest: str) -> bytes | None:
    """The bytes of a file; None if they are not those that are meant."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    # What is unpacked is what the client wrote, whoever else may write there.
    return data if hashlib.sha256(data).hexdigest() == digest else None


def _found(job: Job, step: str, spans: list[Span]) -> SparseRows:
    """All rows of a step that other workers solved."""
    parts = []
    for start, stop in spans:
        file = Path(job.folder) / tile_name(step, (start, stop))
        part = _patiently(partial(read_tile, file, job.token, stop - start))
        if part is None:
            raise InputError(
                f"{file}: is missing or damaged",
                hint="run the same estimate again; it computes that tile anew",
            )
        parts.append(part)
    return SparseRows.joined(parts)


def _patiently(ask: Callable[[], T | None]) -> T | None:
    """What is asked for, once it is there."""
    deadline = time.monotonic() + PATIENCE
    while (found := ask()) is None and time.monotonic() < deadline:
        time.sleep(0.2)
    return found
