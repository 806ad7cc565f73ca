"""Estimates by several processes, here or on other machines, on Dask's scheduler (extra cluster).

The pool waits for tiles with `distributed.wait`. `distributed.as_completed` has one deadline for
all tiles, so it could not notice that every worker is gone.
"""

import gc
import hashlib
import io
import logging
import os
import pickle
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, dataclass, fields, is_dataclass
from multiprocessing import spawn
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from lightmatrix._version import __version__
from lightmatrix.errors import ClusterError, InputError, LightMatrixError
from lightmatrix.estimators.work import SolveTile, TilesInMemory, Work
from lightmatrix.files.extras import load_extra
from lightmatrix.resources.threads import core_threads
from lightmatrix.transport.checkpoint import Checkpoint, Span
from lightmatrix.transport.sparse_rows import SparseRows

if TYPE_CHECKING:
    from distributed import Client

# The environment variables of the threads of BLAS, which a process reads as it starts, and that of
# the compiled core.
_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CORE_THREADS = "RAYON_NUM_THREADS"
# What Dask runs as a worker of this machine starts, before it loads NumPy. It leaves Ctrl-C, which
# a terminal sends to all processes, to the process that started the workers.
_IGNORE_CTRL_C = """
import signal
def dask_setup(worker):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
"""
_NO_SCHEDULER = "the connection to the scheduler was lost"
_CONTINUE = "finished tiles are kept: run the same estimate again, with workers or without"
_SAME_VERSIONS = "install the same version of lightmatrix, NumPy, SciPy and Python for all workers"


@dataclass(frozen=True)
class Patience:
    """Seconds that processes wait for each other; all are chosen by hand."""

    # For the answer of a scheduler, and for its first worker.
    scheduler: float = 10
    first_worker: float = 30
    # Between two counts of the workers, and without any worker until the estimate is given up. Dask
    # starts a dead worker again within seconds.
    count: float = 2
    no_worker: float = 60
    # Until the tiles of a worker that is silent, such as one that was stopped, go to others. Dask
    # waits for five minutes. Workers report every second or so also while they solve, as the
    # compiled core leaves Python free.
    silent: float = 60


PATIENCE = Patience()


# ---- in the process that hands out tiles


@dataclass(eq=False)
class DaskPool:
    """Checked Dask workers."""

    client: "Client"
    # The estimate that was handed out last, its digest, and Dask's future of it.
    _packed: tuple[Work, str, Any] | None = None

    @property
    def threads(self) -> dict[str, int]:
        """Threads of each present worker, as Dask counts them, by its address."""
        return dict(self.client.nthreads())

    @property
    def parts(self) -> int:
        """Into how many tiles a step is cut at least."""
        # Three for each worker, so that none waits long for the last one. More would cost more to
        # hand out.
        return 3 * max(1, len(self.threads))

    def solve(
        self, work: Work, step: str, spans: list[Span], finished: Checkpoint | TilesInMemory,
        report: Callable[[int], None],
    ) -> None:  # fmt: skip
        """Let workers solve tiles of a step whose earlier steps are finished, and keep each.

        A ClusterError says that all workers are gone, or that a tile has killed several of them.
        """
        from distributed import wait

        # As tasks of their own, the estimate and the rows that it needs travel to each worker once,
        # and again if the one that holds them dies.
        if self._packed is None or self._packed[0] is not work:
            data = pack_work(work)
            future = self.client.submit(bytes, data, pure=False)
            self._packed = work, hashlib.sha256(data).hexdigest(), future
        before = {
            name: self.client.submit(bytes, pickle.dumps(finished.read(name)), pure=False)
            for name in work.steps[step]
        }
        shared = *self._packed[1:], step, before, versions()
        running, done, seen = dict[Any, Span](), 0, time.monotonic()
        try:
            for span in spans:
                running[self.client.submit(solve_tile, span, *shared, pure=False)] = span
            while running:
                try:
                    with self.client.as_current():
                        ended = wait(list(running), PATIENCE.count, "FIRST_COMPLETED").done
                except TimeoutError:
                    ended = set()
                except CancelledError as error:
                    raise ClusterError(_NO_SCHEDULER, hint=_CONTINUE) from error
                for future in ended:
                    # The status is read once, as it changes when a worker dies. Dask lets another
                    # worker solve the tiles of one that died, which `wait` counts as done.
                    if (status := future.status) == "lost":
                        continue
                    start, stop = span = running.pop(future)
                    if status != "finished":
                        raise _tile_error(future, status, span)
                    finished.write(start, stop, future.result(), step)
                    done += stop - start
                    report(done)
                now = time.monotonic()
                if ended or self.threads:
                    seen = now
                elif now > seen + PATIENCE.no_worker:
                    raise ClusterError("no worker is left", hint=_CONTINUE)
        finally:
            # After an error or Ctrl-C the tiles that no worker has begun are taken back.
            if running:
                self.client.cancel(list(running), force=True)


def _tile_error(future: Any, status: str, span: Span) -> Exception:
    if status != "error":
        return ClusterError(_NO_SCHEDULER, hint=_CONTINUE)
    error = future.exception()
    if isinstance(error, InputError):
        # This process has read the capture before.
        hint = "put the capture on a file system that all workers share, by the same path"
        return ClusterError(f"a worker: {error.message}", hint=f"{error.hint or _CONTINUE}; {hint}")
    if isinstance(error, LightMatrixError):
        return error
    if type(error).__name__ == "KilledWorker":
        hint = f"probably memory: use fewer workers, memory or tile_rows. {_CONTINUE}"
        died = f"{error.allowed_failures + 1} workers died while solving them, one after the other"
        return ClusterError(f"rows {span[0]} to {span[1]}: {died}", hint=hint)
    return _worker_error("a worker", error)


def _worker_error(address: str, error: BaseException) -> ClusterError:
    if isinstance(error, ImportError):
        what = f"{address}: does not have this version of lightmatrix ({error})"
        return ClusterError(what, hint=_SAME_VERSIONS)
    return ClusterError(f"{address}: {_words(error)}", hint=_CONTINUE)


def _compare(address: str, found: Mapping[str, str], wanted: Mapping[str, str]) -> None:
    others = {name: own for name, own in wanted.items() if found.get(name) != own}
    if differing := [f"{name} {found.get(name)}, not {own}" for name, own in others.items()]:
        raise ClusterError(f"{address}: has {', '.join(differing)}", hint=_SAME_VERSIONS)


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


@contextmanager
def dask_pool(workers: int | None = None, cluster: str | None = None) -> Iterator[DaskPool]:
    """A pool of new processes or of the workers at `cluster`.

    A ClusterError says that workers cannot be started, the scheduler does not answer or has none,
    or one of them has other versions.
    """
    load_extra("distributed", "estimates by several processes need Dask", "cluster")
    with ExitStack() as stack:
        # Dask is silent here, as whatever matters becomes an error of ours.
        logger = logging.getLogger("distributed")
        stack.callback(logger.setLevel, logger.level)
        logger.setLevel(logging.CRITICAL)
        stack.enter_context(warnings.catch_warnings())
        warnings.filterwarnings("ignore", module=r"distributed(\..*)?")
        # On a busy machine this warning seems to come from another module.
        warnings.filterwarnings("ignore", message="Creating scratch directories")
        if cluster is None:
            client = stack.enter_context(_started(workers or 1))
        else:
            client = stack.enter_context(_connected(cluster))
        for address, answer in client.run(describe_worker, on_error="return").items():
            if isinstance(answer, BaseException):
                # Dask may wrap the ImportError of a worker into another exception.
                raise _worker_error(address, ImportError(_words(answer)))
            _compare(address, answer, versions())
        stack.callback(client.run, close_job, on_error="ignore")
        yield DaskPool(client)


@contextmanager
def _started(workers: int) -> "Iterator[Client]":
    """New workers on this machine, which share its cores."""
    import dask
    from distributed import Client, LocalCluster

    threads = str(max(1, core_threads() // workers))
    blas = dict.fromkeys(_BLAS_THREADS, threads)
    settings = {
        # Dask's monitoring takes 7 to 9 % of a core, its setting of malloc 6 %.
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "20s",
        "distributed.worker.profile.enabled": False,
        "distributed.scheduler.worker-ttl": f"{PATIENCE.silent:g}s",
        "distributed.nanny.pre-spawn-environ": blas,
    }
    with TemporaryDirectory(prefix="lightmatrix-workers-") as folder, ExitStack() as stack:
        stack.enter_context(_without_script())
        # Dask sets the variables in this process too, for the processes that it starts.
        stack.callback(os.environ.update, {n: os.environ[n] for n in blas if n in os.environ})
        stack.callback(lambda: [os.environ.pop(name, None) for name in blas])
        stack.enter_context(dask.config.set(settings))
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
                    env={_CORE_THREADS: threads, **blas},
                )
            )
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError, TimeoutError) as error:
            what = f"{workers} workers could not be started ({_words(error)})"
            raise ClusterError(what, hint="use fewer of them, or none") from error
        yield client


@contextmanager
def _without_script() -> Iterator[None]:
    """Keep workers from importing the user's script, which might start more workers."""
    usual = spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        data = usual(name)
        if name.startswith("Dask Worker process"):
            data.pop("init_main_from_name", None)
            data.pop("init_main_from_path", None)
        return data

    spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        spawn.get_preparation_data = usual


@contextmanager
def _connected(address: str) -> "Iterator[Client]":
    from distributed import Client

    # A client that could not connect is closed when it is collected. Within the constructor of
    # another one, this would wait for ever for a lock that the constructor holds.
    gc.collect()
    try:
        client = Client(
            address, timeout=PATIENCE.scheduler, set_as_default=False, name="lightmatrix"
        )
    # A scheduler of another version may cause any exception.
    except Exception as error:
        raise ClusterError(
            f"{address}: no scheduler of Dask answers ({_words(error)})",
            hint="start one with `dask scheduler` and workers with `dask worker tcp://HOST:8786`, "
            "give the address that the scheduler prints, and check the firewall",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE.first_worker)
        except TimeoutError as error:
            hint = f"start some: dask worker {address}"
            raise ClusterError(f"{address}: has no workers", hint=hint) from error
        yield client


# ---- what travels


def pack_work(work: Work) -> bytes:
    """An estimate as bytes: absolute paths of frames in files, frames in memory, no caches."""
    stream = io.BytesIO()
    try:
        _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        hint = "put your own solver into a module that workers can import"
        raise InputError(f"the estimate cannot be sent to workers ({error})", hint=hint) from error
    return stream.getvalue()


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Path):
            return Path, (os.path.abspath(obj),)
        kind = type(obj)
        if is_dataclass(kind) and kind.__module__.startswith("lightmatrix."):
            values = {part.name: getattr(obj, part.name) for part in fields(obj)}
            # A private field with a default factory is a cache and starts empty.
            for part in fields(obj):
                if part.name.startswith("_") and part.default_factory is not MISSING:
                    values[part.name] = part.default_factory()
            return _rebuild, (kind, values)
        return NotImplemented


def _rebuild(kind: type, values: dict[str, Any]) -> Any:
    # The constructor is not called: what it checks or converts was checked in the first process.
    instance: Any = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


def versions() -> dict[str, str]:
    """The versions that results depend on."""
    return {
        "lightmatrix": __version__, "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__, "scipy": scipy.__version__,
    }  # fmt: skip


# ---- in a worker


@dataclass
class _OpenJob:
    """The one estimate that a worker has open, and the step that it has prepared."""

    digest: str = ""
    work: Work | None = None
    step: str = ""
    solve_tile: SolveTile | None = None


_open_job = _OpenJob()
# A tile takes all threads and the memory of a worker, so only one is solved at a time.
_lock = threading.Lock()


def describe_worker(dask_worker: Any) -> dict[str, str]:
    """The versions of a worker."""
    # Workers that we start have the variable already; others use the threads that Dask gives them.
    os.environ.setdefault(_CORE_THREADS, str(dask_worker.state.nthreads))
    return versions()


def solve_tile(
    span: Span, digest: str, packed: bytes, step: str, before: Mapping[str, bytes],
    wanted: Mapping[str, str],
) -> SparseRows:  # fmt: skip
    """Solve the rows `span` of a step of a packed estimate, given the pickled rows `before` it."""
    from distributed import get_worker

    with _lock:
        if _open_job.digest != digest or _open_job.work is None:
            # Workers may join after the others were checked.
            _compare("a worker", describe_worker(get_worker()), wanted)
            vars(_open_job).update(vars(_OpenJob(digest, pickle.loads(packed))))
            assert _open_job.work is not None
        if _open_job.step != step or _open_job.solve_tile is None:
            # This frees what the step before was prepared with.
            _open_job.solve_tile = None
            _open_job.solve_tile = _open_job.work.prepare(
                step, lambda name: pickle.loads(before[name])
            )
            _open_job.step = step
        return _open_job.solve_tile(*span, lambda done, total: None)


def close_job() -> None:
    """Close the open estimate, unless a tile is being solved."""
    if _lock.acquire(blocking=False):
        vars(_open_job).update(vars(_OpenJob()))
        _lock.release()
