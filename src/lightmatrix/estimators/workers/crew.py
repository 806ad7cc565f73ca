"""Tiles handed out to workers, again where a worker died."""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from lightmatrix.errors import ClusterError, LightMatrixError
from lightmatrix.estimators.steps import Work
from lightmatrix.estimators.workers.solving import JOB, PATIENCE, Job, forget, look, look_of, solve
from lightmatrix.estimators.workers.travel import packed
from lightmatrix.store import Checkpoint
from lightmatrix.store.tiles import Span, tile_name

if TYPE_CHECKING:
    from distributed import Client, Future

# A step has so many tiles for each worker, so that none waits long for the last one.
TILES_EACH = 3
# So many lie with each worker: the next one is there as it ends one.
_AHEAD = 2
# Seconds after which workers are counted again, and without any after which there is no hope.
_AGAIN, _HOPE = 2.0, 60.0


@dataclass(eq=False)
class DaskCrew:
    """Workers of Dask that solve tiles and write them; made by `opened`.

    Parameters
    ----------
    client : distributed.Client
        Of a scheduler whose workers were checked.
    cores : int
        Threads of all of them.
    memory : int
        Bytes that each is expected to take.
    """

    client: Client
    cores: int
    memory: int
    _jobs: WeakKeyDictionary[Checkpoint, Job] = field(default_factory=WeakKeyDictionary)
    # Tiles that ended. Dask is told with the next ones: what is sent soon after waits for 10 ms.
    _over: list[Future] = field(default_factory=list)

    def __str__(self) -> str:
        count = len(self.threads)
        workers = f"{count} worker{'s' if count > 1 else ''}"
        return f"{workers}, {self.cores} threads in all, about {self.memory / 2**30:.2g} GiB each"

    @property
    def threads(self) -> dict[str, int]:
        """Threads of each worker that is there, as Dask counts them, by its address."""
        return dict(self.client.nthreads())

    @property
    def parts(self) -> int:
        """Into how many tiles a step is cut at least."""
        return TILES_EACH * max(1, len(self.threads))

    def solve(self, work: Work, step: str, spans: list[Span], running: Checkpoint) -> None:
        """Let workers solve tiles of a step, and count them as finished.

        Parameters
        ----------
        work : Work
        step : str
            The steps that it needs are whole.
        spans : list of (int, int)
            Rows of each tile.
        running : Checkpoint
            Where the tiles are written.

        Raises
        ------
        ClusterError
            If a worker does not see the capture or the output, all are gone, or a tile has killed
            several of them.
        LightMatrixError
            As an estimate in one process.
        """
        job = self._job(work, running)
        waiting, going = deque(spans), dict[Any, Span]()
        before = {name: running.spans(name) for name in work.steps[step]}
        report, total = work.report(step), sum(stop - start for start, stop in spans)
        done = max((stop for _, stop in spans), default=0) - total
        threads: dict[str, int] = {}
        seen = time.monotonic()
        try:
            while waiting or going:
                now = time.monotonic()
                if not threads or now > seen + _AGAIN:
                    threads = self.threads
                    seen = now if threads else seen
                if not threads and now > seen + _HOPE:
                    raise ClusterError("no worker is left", hint=_GO_ON)
                while waiting and len(going) < _wanted(len(waiting), len(threads)):
                    span = waiting.popleft()
                    # Its name stands in the folder before a worker writes it.
                    running.place(*span, step)
                    going[self._submit(job, step, span, before, threads)] = span
                    self._over.clear()
                for future, status in self._ended(going):
                    span = going.pop(future)
                    self._over.append(future)
                    self._check(future, status, running, step, span)
                    running.add(*span, step)
                    done += span[1] - span[0]
                    if report is not None:
                        report(done, total)
        finally:
            # After Ctrl-C too: what was not begun yet is taken back.
            if going:
                self.client.cancel(list(going), force=True)

    def close(self) -> None:
        """Let the workers close what they opened."""
        self._over.clear()
        self.client.run(forget, on_error="ignore")

    def _job(self, work: Work, running: Checkpoint) -> Job:
        """The estimate where workers find it, which each of them was asked about."""
        if running not in self._jobs:
            data = packed(work)
            running.keep(JOB, data)
            digest = hashlib.sha256(data).hexdigest()
            job = Job(str(running.folder), digest, running.token, look_of(work.capture))
            for address, answer in self.client.run(look, job, on_error="return").items():
                if isinstance(answer, BaseException):
                    raise _of_worker(address, answer)
            self._jobs[running] = job
        return self._jobs[running]

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
        return self.client.submit(solve, job, step, span, before, each, key=key, pure=False)

    def _ended(self, going: dict[Any, Span]) -> Iterator[tuple[Any, str]]:
        """Tiles that ended and how ("finished" or "error"), after a short while at most.

        Not those whose worker died before it was asked: Dask has them solved again, and counts them
        as done meanwhile.
        """
        from distributed import wait

        if not going:
            time.sleep(0.1)
            return
        try:
            with self.client.as_current():
                ended = wait(list(going), timeout=_AGAIN, return_when="FIRST_COMPLETED")
        except TimeoutError:
            return
        except CancelledError as error:
            raise ClusterError(_NO_SCHEDULER, hint=_GO_ON) from error
        for future in ended.done:
            # Read once: it changes as workers die.
            status = future.status
            if status != "lost":
                yield future, status

    def _check(self, future: Any, status: str, running: Checkpoint, step: str, span: Span) -> None:
        """Whether a tile that ended is where it should be.

        Raises
        ------
        LightMatrixError
            What went wrong, where it was solved.
        """
        if status == "finished":
            file = running.place(*span, step)
            deadline = time.monotonic() + PATIENCE
            while not file.is_file():
                if time.monotonic() > deadline:
                    raise ClusterError(
                        f"{file}: was written by a worker, but is not seen here", hint=_SHARED
                    )
                time.sleep(0.1)
            return
        if status != "error":
            raise ClusterError(_NO_SCHEDULER, hint=_GO_ON)
        error = future.exception()
        if isinstance(error, LightMatrixError):
            raise error
        if type(error).__name__ == "KilledWorker":
            raise ClusterError(
                f"rows {span[0]} to {span[1]}: {error.allowed_failures + 1} workers died of them, "
                "one after the other",
                hint=f"probably memory: use fewer workers, --memory or --tile-rows. {_GO_ON}",
            ) from error
        raise _of_worker("a worker", error) from error


def _wanted(waiting: int, workers: int) -> int:
    """How many tiles lie with all workers: of the last ones each gets one, as it ends another."""
    return workers * (_AHEAD if waiting > workers else 1)


_NO_SCHEDULER = "the connection to the scheduler was lost"
_SHARED = "write the output to a file system that all workers share, by the same path"
_GO_ON = "finished tiles are kept: run the same estimate again, with workers or without"


def _of_worker(address: str, error: BaseException) -> ClusterError:
    """What a worker answers, with its address."""
    if isinstance(error, LightMatrixError):
        return ClusterError(f"{address}: {error.message}", hint=error.hint)
    if isinstance(error, ImportError):
        return ClusterError(f"{address}: has no lightmatrix like this one ({error})", hint=SAME)
    told = " ".join(str(error).split())[:300]
    return ClusterError(f"{address}: {type(error).__name__}: {told}", hint=_GO_ON)


SAME = "install the same version of lightmatrix, NumPy, SciPy and Python for all workers"
