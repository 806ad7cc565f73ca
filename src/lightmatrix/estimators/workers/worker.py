"""What runs in a worker: it opens an estimate once, and solves and writes tiles of it."""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import platform
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import PixelFrames
from lightmatrix.errors import ClusterError, InputError, LightMatrixError
from lightmatrix.estimators.work import SolveTile, Work
from lightmatrix.resources.memory import available_bytes
from lightmatrix.resources.threads import core_threads
from lightmatrix.transport.checkpoint import (
    Span,
    fingerprint_token,
    read_tile,
    tile_name,
    write_tile,
)
from lightmatrix.transport.sparse_rows import SparseRows


def pack_work(work: Work) -> bytes:
    """An estimate as bytes: absolute paths of frames in files, frames in memory, no caches."""
    stream = io.BytesIO()
    try:
        _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"the estimate cannot be sent to workers ({error})",
            hint="put your own solver into a module that workers can import",
        ) from error
    return stream.getvalue()


def unpack_work(data: bytes) -> Work:
    """The estimate that `pack_work` packed. Bytes from elsewhere may run any program."""
    work: Work = pickle.loads(data)
    return work


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Path):
            return Path, (os.path.abspath(obj),)
        if is_dataclass(obj) and not isinstance(obj, type):
            kind = type(obj)
            if kind.__module__.startswith("lightmatrix."):
                return _rebuild, (kind, {part.name: _value(obj, part) for part in fields(obj)})
        return NotImplemented


def _value(obj: Any, part: Field[Any]) -> Any:
    """The value of a field. A private field with a default factory is a cache and starts empty."""
    if part.name.startswith("_") and part.default_factory is not MISSING:
        return part.default_factory()
    return getattr(obj, part.name)


def _rebuild(kind: type, values: dict[str, Any]) -> Any:
    # The constructor is not called: what it checks or converts was checked in the first process.
    instance: Any = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


# The file of the packed estimate in the folder of the running results.
JOB_FILE = "job.pickle"
# Seconds for which a file may be missing before it counts as missing: a shared file system may show
# the files of other machines some seconds late. Chosen by hand.
FILE_PATIENCE = 15.0
# Camera samples of all frames by which captures are compared, where frames are stored by pixel.
# Chosen by hand: their levels are read in an instant.
_COMPARED_SAMPLES = 64
# The environment variable that says how many threads the compiled core uses.
_THREADS = "RAYON_NUM_THREADS"
SHARE_OUTPUT = "write the output to a file system that all workers share, by the same path"
SHARE_CAPTURE = "put the capture on a file system that all workers share, by the same path"
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """An estimate in a folder of running results that all workers share."""

    folder: str
    # Hash of the packed estimate; `token` is the fingerprint of the running results.
    digest: str
    token: str
    capture_hash: str
    version: str = __version__


@dataclass
class _OpenJob:
    """The one estimate that a worker has open, and the step that it has prepared."""

    job: Job | None = None
    work: Work | None = None
    step: str = ""
    solve_tile: SolveTile | None = None
    # A tile takes all threads and the memory of a worker, so only one is solved at a time.
    lock: threading.Lock = field(default_factory=threading.Lock)

    def clear(self) -> None:
        self.job, self.work, self.step, self.solve_tile = None, None, "", None


_open_job = _OpenJob()


def describe_worker(dask_worker: Any) -> dict[str, Any]:
    """The threads, versions, host, process and free memory of a worker, JSON-ready."""
    # Workers that we start have the variable already; others use the threads that Dask gives them.
    os.environ.setdefault(_THREADS, str(dask_worker.state.nthreads))
    return {
        "threads": core_threads(),
        "versions": versions(),
        "host": platform.node(),
        "process": os.getpid(),
        "available": available_bytes(),
    }


def versions() -> dict[str, str]:
    """The versions that results depend on."""
    return {
        "lightmatrix": __version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def capture_hash(capture: Capture) -> str:
    """A hash of a few frames or pixels of a capture, by which another capture is noticed."""
    frames = capture.frames
    if isinstance(frames, PixelFrames):
        parts = [frames.levels(0, min(_COMPARED_SAMPLES, int(np.prod(frames.shape))))]
    else:
        parts = [frames.read(0), frames.read(frames.count - 1)]
    hasher = hashlib.sha256(capture.patterns.digest.encode())
    for part in parts:
        hasher.update(repr((part.shape, part.dtype.str)).encode())
        hasher.update(np.ascontiguousarray(part).tobytes())
    return hasher.hexdigest()


def check_access(job: Job) -> None:
    """Check that this worker sees the capture and may write the output, or raise a ClusterError."""
    folder = Path(job.folder)
    if _wait_for(lambda: fingerprint_token(folder)) != job.token:
        raise ClusterError(f"does not see the running results in {folder}", hint=SHARE_OUTPUT)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ClusterError(
            f"may not write in {folder}", hint="let workers run as a user who may write there"
        )
    with _open_job.lock:
        work = _work(job)
        try:
            same = capture_hash(work.capture) == job.capture_hash
        except LightMatrixError as error:
            raise ClusterError(
                f"cannot read the capture: {error.message}", hint=SHARE_CAPTURE
            ) from error
    if not same:
        raise ClusterError("sees another capture by the path of this one", hint=SHARE_CAPTURE)


def solve_tile(
    job: Job, step: str, span: Span, before: Mapping[str, list[Span]], threads: int
) -> None:
    """Solve the rows `span` of a step, given finished tiles `before`, and write them."""
    if job.version != __version__:
        raise ClusterError(
            f"a worker has lightmatrix {__version__}, this is {job.version}",
            hint="install the same version for all workers",
        )
    with _open_job.lock:
        os.environ.setdefault(_THREADS, str(threads))
        work = _work(job)
        if _open_job.step != step or _open_job.solve_tile is None:
            _open_job.solve_tile = work.prepare(
                step, lambda name: _read_step(job, name, before[name])
            )
            _open_job.step = step
        rows = _open_job.solve_tile(*span, lambda done, total: None)
        write_tile(Path(job.folder) / tile_name(step, span), job.token, rows)


def close_job() -> None:
    """Close the open estimate, unless a tile is being solved."""
    if _open_job.lock.acquire(blocking=False):
        try:
            _open_job.clear()
        finally:
            _open_job.lock.release()


def _work(job: Job) -> Work:
    if _open_job.job != job or _open_job.work is None:
        _open_job.clear()
        file = Path(job.folder) / JOB_FILE
        data = _wait_for(lambda: _bytes_of(file, job.digest))
        if data is None:
            raise ClusterError(f"does not find the estimate in {file}", hint=SHARE_OUTPUT)
        _open_job.job, _open_job.work = job, unpack_work(data)
    return _open_job.work


def _bytes_of(file: Path, digest: str) -> bytes | None:
    """The bytes of a file; None unless they have the right digest."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    # The digest came from the client, so nobody else can have written what is unpickled.
    return data if hashlib.sha256(data).hexdigest() == digest else None


def _read_step(job: Job, step: str, spans: list[Span]) -> SparseRows:
    """All rows of a finished step."""
    parts = []
    for start, stop in spans:
        file = Path(job.folder) / tile_name(step, (start, stop))
        part = _wait_for(partial(read_tile, file, job.token, stop - start))
        if part is None:
            raise InputError(
                f"{file}: is missing or damaged",
                hint="run the same estimate again; it computes that tile anew",
            )
        parts.append(part)
    return SparseRows.joined(parts)


def _wait_for(read: Callable[[], T | None]) -> T | None:
    """What `read` returns, repeated while that is None and `FILE_PATIENCE` is not over."""
    deadline = time.monotonic() + FILE_PATIENCE
    while (value := read()) is None and time.monotonic() < deadline:
        time.sleep(0.2)
    return value
