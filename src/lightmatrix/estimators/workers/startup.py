"""Starts workers on this machine, or connects to those of a cluster, and checks them."""

from __future__ import annotations

import gc
import logging
import os
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from multiprocessing import spawn
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from lightmatrix.errors import ClusterError, MissingExtraError
from lightmatrix.estimators.resource_estimate import ResourceEstimate
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.workers import preload
from lightmatrix.estimators.workers.pool import SAME_VERSIONS, DaskPool
from lightmatrix.estimators.workers.worker import describe_worker, versions
from lightmatrix.resources.threads import core_threads

if TYPE_CHECKING:
    from distributed import Client

# Seconds to wait for the answer of a scheduler, and for its first worker. Chosen by hand.
SCHEDULER_TIMEOUT, WORKER_TIMEOUT = 10, 30
# The beginning of the names that Dask gives the processes of its workers.
_WORKER = "Dask Worker process"
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
                    preload=[preload.__name__],
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
