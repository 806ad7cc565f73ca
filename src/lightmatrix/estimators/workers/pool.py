"""A pool of Dask workers: hands out tiles, and hands them out again where a worker died.

It waits for tiles with `distributed.wait`. `distributed.as_completed` would be shorter, but it has
one deadline for all tiles, so it could not notice that every worker is gone; and it returns the
tiles of a worker that died as if they had ended.
"""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from lightmatrix.errors import ClusterError, LightMatrixError
from lightmatrix.estimators.work import Work
from lightmatrix.estimators.workers.pickling import pack_work
from lightmatrix.estimators.workers.worker import (
    FILE_PATIENCE,
    JOB_FILE,
    SHARE_OUTPUT,
    Job,
    capture_hash,
    check_access,
    close_job,
    solve_tile,
)
from lightmatrix.store import Checkpoint
from lightmatrix.store.checkpoint import Span, tile_name

if TYPE_CHECKING:
    from distributed import Client, Future

# A step is cut into this many tiles for each worker, so that none waits long for the last one.
# Chosen by hand: more tiles cost more to hand out.
TILES_EACH = 3
# Each worker holds this many tiles, so that the next one is at hand when it finishes one.
_AHEAD = 2
# Seconds between two counts of the workers, and seconds without any worker after which the estimate
# is given up. Chosen by hand: a nanny starts a dead worker again within seconds.
_COUNT_INTERVAL, _GIVE_UP = 2.0, 60.0
_NO_SCHEDULER = "the connection to the scheduler was lost"
_CONTINUE = "finished tiles are kept: run the same estimate again, with workers or without"
SAME_VERSIONS = "install the same version of lightmatrix, NumPy, SciPy and Python for all workers"


@dataclass(eq=False)
class DaskPool:
    """Checked Dask workers of `cores` threads together that take `memory` bytes each."""

    client: Client
    cores: int
    memory: int
    _jobs: WeakKeyDictionary[Checkpoint, Job] = field(default_factory=WeakKeyDictionary)
    # Tiles that ended. They are released with the next submission, as a message of its own would
    # delay what is sent after it by 10 ms.
    _ended_tiles: list[Future] = field(default_factory=list)

    def __str__(self) -> str:
        count = len(self.threads)
        workers = f"{count} worker{'s' if count > 1 else ''}"
        return f"{workers}, {self.cores} threads in all, about {self.memory / 2**30:.2g} GiB each"

    @property
    def threads(self) -> dict[str, int]:
        """Threads of each present worker, as Dask counts them, by its address."""
        return dict(self.client.nthreads())

    @property
    def parts(self) -> int:
        """Into how many tiles a step is cut at least."""
        return TILES_EACH * max(1, len(self.threads))

    def solve(
        self,
        work: Work,
        step: str,
        spans: list[Span],
        checkpoint: Checkpoint,
        report: Callable[[int], None],
    ) -> None:
        """Let workers solve tiles of a step whose earlier steps are finished; see `WorkerPool`.

        Raises
        ------
        ClusterError
            If a worker does not see the capture or the output, all are gone, or a tile has killed
            several of them.
        LightMatrixError
            As an estimate in one process.
        """
        job = self._job(work, checkpoint)
        waiting, running = deque(spans), dict[Any, Span]()
        before = {name: checkpoint.spans(name) for name in work.steps[step]}
        done = 0
        threads: dict[str, int] = {}
        counted = time.monotonic()
        try:
            while waiting or running:
                now = time.monotonic()
                if not threads or now > counted + _COUNT_INTERVAL:
                    threads = self.threads
                    counted = now if threads else counted
                if not threads and now > counted + _GIVE_UP:
                    raise ClusterError("no worker is left", hint=_CONTINUE)
                while waiting and len(running) < _tiles_ahead(len(waiting), len(threads)):
                    span = waiting.popleft()
                    # The checkpoint knows the name of the file before a worker writes it.
                    checkpoint.place(*span, step)
                    running[self._submit(job, step, span, before, threads)] = span
                    self._ended_tiles.clear()
                for future, status in self._ended(running):
                    span = running.pop(future)
                    self._ended_tiles.append(future)
                    self._check(future, status, checkpoint, step, span)
                    checkpoint.add(*span, step)
                    done += span[1] - span[0]
                    report(done)
        finally:
            # After an error or Ctrl-C the tiles that no worker has begun are taken back.
            if running:
                self.client.cancel(list(running), force=True)

    def close(self) -> None:
        """Let the workers close the estimate that they have open."""
        self._ended_tiles.clear()
        self.client.run(close_job, on_error="ignore")

    def _job(self, work: Work, checkpoint: Checkpoint) -> Job:
        """The job of an estimate; as it is new, every worker checks its access to the files."""
        if checkpoint not in self._jobs:
            data = pack_work(work)
            checkpoint.keep(JOB_FILE, data)
            digest = hashlib.sha256(data).hexdigest()
            folder = str(checkpoint.folder)
            job = Job(folder, digest, checkpoint.token, capture_hash(work.capture))
            for address, answer in self.client.run(check_access, job, on_error="return").items():
                if isinstance(answer, BaseException):
                    raise _worker_error(address, answer)
            self._jobs[checkpoint] = job
        return self._jobs[checkpoint]

    def _submit(
        self,
        job: Job,
        step: str,
        span: Span,
        before: dict[str, list[Span]],
        threads: dict[str, int],
    ) -> Future:
        key = f"{tile_name(step, span)}-{job.digest[:8]}-{time.monotonic_ns()}"
        each = min(threads.values())
        return self.client.submit(solve_tile, job, step, span, before, each, key=key, pure=False)

    def _ended(self, running: dict[Any, Span]) -> Iterator[tuple[Any, str]]:
        """Tiles that ended and how ("finished" or "error"), after `_COUNT_INTERVAL` at most.

        `wait` counts tiles whose worker died as done, but Dask lets another worker solve them:
        skipped.
        """
        from distributed import wait

        if not running:
            time.sleep(0.1)
            return
        try:
            with self.client.as_current():
                ended = wait(list(running), timeout=_COUNT_INTERVAL, return_when="FIRST_COMPLETED")
        except TimeoutError:
            return
        except CancelledError as error:
            raise ClusterError(_NO_SCHEDULER, hint=_CONTINUE) from error
        for future in ended.done:
            # The status is read once, as it changes when a worker dies.
            status = future.status
            if status != "lost":
                yield future, status

    def _check(
        self, future: Any, status: str, checkpoint: Checkpoint, step: str, span: Span
    ) -> None:
        """Check that the file of a tile that ended is there, or raise what went wrong."""
        if status == "finished":
            file = checkpoint.place(*span, step)
            deadline = time.monotonic() + FILE_PATIENCE
            while not file.is_file():
                if time.monotonic() > deadline:
                    raise ClusterError(
                        f"{file}: was written by a worker, but is not visible here",
                        hint=SHARE_OUTPUT,
                    )
                time.sleep(0.1)
            return
        if status != "error":
            raise ClusterError(_NO_SCHEDULER, hint=_CONTINUE)
        error = future.exception()
        if isinstance(error, LightMatrixError):
            raise error
        if type(error).__name__ == "KilledWorker":
            raise ClusterError(
                f"rows {span[0]} to {span[1]}: {error.allowed_failures + 1} workers died while "
                "solving them, one after the other",
                hint=f"probably memory: use fewer workers, --memory or --tile-rows. {_CONTINUE}",
            ) from error
        raise _worker_error("a worker", error) from error


def _tiles_ahead(waiting: int, workers: int) -> int:
    """Tiles that all workers hold together; one each when the last tiles are handed out."""
    return workers * (_AHEAD if waiting > workers else 1)


def _worker_error(address: str, error: BaseException) -> ClusterError:
    """The error of a worker, with its address."""
    if isinstance(error, LightMatrixError):
        return ClusterError(f"{address}: {error.message}", hint=error.hint)
    if isinstance(error, ImportError):
        return ClusterError(
            f"{address}: does not have this version of lightmatrix ({error})", hint=SAME_VERSIONS
        )
    words = " ".join(str(error).split())[:300]
    return ClusterError(f"{address}: {type(error).__name__}: {words}", hint=_CONTINUE)
