"""A pool of Dask workers: hands out tiles, and hands them out again where a worker died.

It waits for tiles with `distributed.wait`. `distributed.as_completed` would be shorter, but it has
one deadline for all tiles, so it could not notice that every worker is gone; and it returns the
tiles of a worker that died as if they had ended.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing import spawn
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from lightmatrix.errors import ClusterError, LightMatrixError, MissingExtraError
from lightmatrix.estimators.resource_estimate import ResourceEstimate
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.work import Work
from lightmatrix.estimators.workers.worker import (
    FILE_PATIENCE,
    JOB_FILE,
    SHARE_OUTPUT,
    Job,
    capture_hash,
    check_access,
    close_job,
    describe_worker,
    pack_work,
    solve_tile,
    versions,
)
from lightmatrix.resources.threads import core_threads
from lightmatrix.transport.checkpoint import Checkpoint, Span, tile_name

if TYPE_CHECKING:
    from distributed import Client


# A step is cut into this many tiles for each worker, so that none waits long for the last one.
# Chosen by hand: more tiles cost more to hand out.
TILES_EACH = 3
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
        from distributed import wait

        job, threads = self._job(work, checkpoint), self.threads
        before = {name: checkpoint.spans(name) for name in work.steps[step]}
        running, done = dict[Any, Span](), 0
        each, seen = min(threads.values(), default=1), time.monotonic()
        try:
            for span in spans:
                # The checkpoint knows the name of the file before a worker writes it.
                checkpoint.place(*span, step)
                key = f"{tile_name(step, span)}-{job.digest[:8]}-{time.monotonic_ns()}"
                running[
                    self.client.submit(
                        solve_tile, job, step, span, before, each, key=key, pure=False
                    )
                ] = span
            while running:
                try:
                    with self.client.as_current():
                        ended = wait(list(running), _COUNT_INTERVAL, "FIRST_COMPLETED").done
                except TimeoutError:
                    ended = set()
                except CancelledError as error:
                    raise ClusterError(_NO_SCHEDULER, hint=_CONTINUE) from error
                for future in ended:
                    # The status is read once, as it changes when a worker dies. Dask lets another
                    # worker solve the tiles of one that died, which `wait` counts as done.
                    if (status := future.status) == "lost":
                        continue
                    span = running.pop(future)
                    self._check(future, status, checkpoint, step, span)
                    checkpoint.add(*span, step)
                    done += span[1] - span[0]
                    report(done)
                now = time.monotonic()
                if ended or self.threads:
                    seen = now
                elif now > seen + _GIVE_UP:
                    raise ClusterError("no worker is left", hint=_CONTINUE)
        finally:
            # After an error or Ctrl-C the tiles that no worker has begun are taken back.
            if running:
                self.client.cancel(list(running), force=True)

    def close(self) -> None:
        """Let the workers close the estimate that they have open."""
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


# Seconds to wait for the answer of a scheduler, and for its first worker. Chosen by hand.
SCHEDULER_TIMEOUT, WORKER_TIMEOUT = 10, 30
# The beginning of the names that Dask gives the processes of its workers.
_WORKER = "Dask Worker process"
# What Dask runs as a worker of this machine starts, before it loads NumPy. It leaves Ctrl-C, which
# a terminal sends to all processes, to the process that started the workers.
_IGNORE_CTRL_C = """
import signal
def dask_setup(worker):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
"""
# Seconds after which the tiles of a worker that is silent, such as one that was stopped, go to
# others. Workers report every second or so also while they solve, as the compiled core leaves
# Python free. Chosen by hand: Dask waits for five minutes.
SILENT_TOO_LONG = 60.0
# Environment variables of the threads of BLAS, which a process reads as it starts, and of the
# compiled core.
_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_THREADS = ("RAYON_NUM_THREADS", *_BLAS_THREADS)


@contextmanager
def open_workers(
    settings: EstimateSettings, resources: ResourceEstimate
) -> Iterator[DaskPool | None]:
    """Start or find the workers that the settings ask for, until the estimate is done.

    Parameters
    ----------
    settings : EstimateSettings
        The settings of the estimate.
    resources : ResourceEstimate
        What `estimate_resources` says of it.

    Yields
    ------
    DaskPool or None
        The workers; None for an estimate by this process.

    Raises
    ------
    MissingExtraError
        If Dask is missing.
    ClusterError
        If workers cannot be started, the scheduler does not answer or has none, or one of them has
        other versions or too little memory.
    """
    if settings.workers is None and settings.cluster is None:
        yield None
        return
    with dask_pool(
        settings.workers, settings.cluster, resources.memory // resources.workers
    ) as pool:
        yield pool


@contextmanager
def dask_pool(
    workers: int | None = None, cluster: str | None = None, memory: int = 0
) -> Iterator[DaskPool]:
    """A pool of new processes or of the workers at `cluster`, which take `memory` bytes each."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            "estimates by several processes need Dask",
            hint="install it: pip install 'lightmatrix[cluster]'",
        ) from error
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if cluster is not None:
            client = stack.enter_context(_connected(cluster))
        else:
            client = stack.enter_context(_started(workers or 1))
        descriptions = _descriptions(client, cluster or "the workers started here")
        if cluster is not None:
            _check_memory(descriptions, memory)
        pool = DaskPool(client, sum(worker["threads"] for worker in descriptions), memory)
        stack.callback(pool.close)
        yield pool


def threads_each(workers: int) -> int:
    """Threads of each worker, as `workers` of them share this machine."""
    return max(1, core_threads() // workers)


@contextmanager
def _started(workers: int) -> Iterator[Client]:
    from distributed import Client, LocalCluster

    threads = str(threads_each(workers))
    with TemporaryDirectory(prefix="lightmatrix-workers-") as folder, ExitStack() as stack:
        stack.enter_context(_without_script())
        stack.enter_context(_without_monitoring(threads))
        try:
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                    # Tiles bound the memory. Dask would kill a worker at a share of its limit.
                    memory_limit=0,
                    local_directory=folder,
                    preload=[_IGNORE_CTRL_C],
                    env=dict.fromkeys(_THREADS, threads),
                )
            )
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError, TimeoutError) as error:
            words = " ".join(str(error).split())[:200]
            raise ClusterError(
                f"{workers} workers could not be started ({type(error).__name__}: {words})",
                hint="use fewer of them, or none",
            ) from error
        yield client


@contextmanager
def _without_script() -> Iterator[None]:
    """Keep workers from importing the user's script, which might start more workers."""
    usual = spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        data = usual(name)
        if name.startswith(_WORKER):
            data.pop("init_main_from_name", None)
            data.pop("init_main_from_path", None)
        return data

    spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        spawn.get_preparation_data = usual


@contextmanager
def _without_monitoring(threads: str) -> Iterator[None]:
    """Start workers without Dask's monitoring (7 to 9 % of a core) and malloc setting (6 %)."""
    import dask

    blas = dict.fromkeys(_BLAS_THREADS, threads)
    before = {name: os.environ.get(name) for name in blas}
    settings = {
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "20s",
        "distributed.worker.profile.enabled": False,
        "distributed.scheduler.worker-ttl": f"{SILENT_TOO_LONG:g}s",
        "distributed.nanny.pre-spawn-environ": blas,
    }
    try:
        with dask.config.set(settings):
            yield
    finally:
        # Dask sets the variables in this process too, for the processes that it starts.
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    # A client that could not connect is closed when it is collected. Within the constructor of
    # another one, this would wait for ever for a lock that the constructor holds.
    gc.collect()
    try:
        client = Client(
            address, timeout=SCHEDULER_TIMEOUT, set_as_default=False, name="lightmatrix"
        )
    # A scheduler of another version may cause any exception.
    except Exception as error:
        words = " ".join(str(error).split())[:200]
        raise ClusterError(
            f"{address}: no scheduler of Dask answers ({type(error).__name__}: {words})",
            hint="start one with `dask scheduler` and workers with `dask worker tcp://HOST:8786`, "
            "give the address that the scheduler prints, and check the firewall",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT)
        except TimeoutError as error:
            raise ClusterError(
                f"{address}: has no workers", hint=f"start some: dask worker {address}"
            ) from error
        yield client


def _descriptions(client: Client, address: str) -> list[dict[str, Any]]:
    """What each worker says of itself, after a check of its versions."""
    answers = client.run(describe_worker, on_error="return")
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            raise ClusterError(
                f"{address}: worker {worker} does not have this version of lightmatrix "
                f"({type(answer).__name__}: {' '.join(str(answer).split())[:200]})",
                hint=SAME_VERSIONS,
            )
        differing = _differing_versions(answer["versions"])
        if differing:
            raise ClusterError(f"{address}: worker {worker} has {differing}", hint=SAME_VERSIONS)
    return list(answers.values())


def _check_memory(descriptions: list[dict[str, Any]], memory: int) -> None:
    """Check that all workers of each machine together have enough memory."""
    for host, count in Counter(worker["host"] for worker in descriptions).items():
        free = min(worker["available"] for worker in descriptions if worker["host"] == host)
        if count * memory > free:
            raise ClusterError(
                f"{host}: {count} workers take about {count * memory / 2**30:.2g} GiB of memory, "
                f"{free / 2**30:.2g} GiB are free",
                hint="use fewer workers with more threads each, or --memory for each of them",
            )


def _differing_versions(theirs: Mapping[str, str]) -> str:
    """The versions of a worker that differ from those of this process, in words."""
    return ", ".join(
        f"{name} {theirs.get(name)}, not {own}"
        for name, own in versions().items()
        if theirs.get(name) != own
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask; whatever matters becomes an error of ours."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"distributed(\..*)?")
            # On a busy machine this warning seems to come from another module.
            warnings.filterwarnings("ignore", message="Creating scratch directories")
            yield
    finally:
        logger.setLevel(level)
