"""Workers started on this machine, or found by the address of their scheduler, and checked."""

from __future__ import annotations

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
from lightmatrix.estimators.needs import usual_threads
from lightmatrix.estimators.workers import started
from lightmatrix.estimators.workers.crew import SAME, DaskCrew
from lightmatrix.estimators.workers.solving import about, versions

if TYPE_CHECKING:
    from distributed import Client

# Seconds that a scheduler may take to answer, and its first worker to come.
ANSWER, ARRIVAL = 10, 30
# What Dask calls the processes of its workers.
_WORKER = "Dask Worker process"
# Of BLAS, which reads them as a process starts, and of the compiled core.
_THREADS_OF_BLAS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_THREADS = ("RAYON_NUM_THREADS", *_THREADS_OF_BLAS)


@contextmanager
def opened(
    workers: int | None = None, cluster: str | None = None, memory: int = 0
) -> Iterator[DaskCrew]:
    """Workers of an estimate, until it is done.

    Parameters
    ----------
    workers : int, optional
        So many processes are started on this machine, which share its cores.
    cluster : str, optional
        The address of a scheduler of Dask, such as tcp://10.0.0.1:8786, with workers.
    memory : int
        Bytes that each worker will take.

    Raises
    ------
    MissingExtraError
        Without Dask.
    ClusterError
        If workers cannot be started, nobody answers, there are none, one of them has no
        lightmatrix or another version, or there is no memory for them.
    """
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
        facts = _facts(client, cluster or "the workers started here")
        if cluster is not None:
            _check_memory(facts, memory)
        crew = DaskCrew(client, sum(fact["threads"] for fact in facts), memory)
        stack.callback(crew.close)
        yield crew


def threads_each(workers: int) -> int:
    """Threads of each of some workers on this machine."""
    return max(1, usual_threads() // workers)


@contextmanager
def _started(workers: int) -> Iterator[Client]:
    from distributed import Client, LocalCluster

    threads = str(threads_each(workers))
    with TemporaryDirectory(prefix="lightmatrix-workers-") as folder, ExitStack() as stack:
        stack.enter_context(_without_script())
        stack.enter_context(_bare(threads))
        try:
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                    # A tile is what bounds memory, not Dask, which would kill at a share of it.
                    memory_limit=0,
                    local_directory=folder,
                    preload=[started.__name__],
                    env=dict.fromkeys(_THREADS, threads),
                )
            )
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError, TimeoutError) as error:
            told = " ".join(str(error).split())[:200]
            raise ClusterError(
                f"{workers} workers could not be started ({type(error).__name__}: {told})",
                hint="use fewer of them, or none",
            ) from error
        yield client


@contextmanager
def _without_script() -> Iterator[None]:
    """Start workers without the script that is running, which spawned processes read again.

    They need nothing of it, and one that estimates with workers as it is read would start others.
    """
    usual = spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        told = usual(name)
        if name.startswith(_WORKER):
            told.pop("init_main_from_name", None)
            told.pop("init_main_from_path", None)
        return told

    spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        spawn.get_preparation_data = usual


@contextmanager
def _bare(threads: str) -> Iterator[None]:
    """Start workers that do little else than tiles.

    Dask's looks at itself, for a dashboard that nobody sees, take 7 to 9 % of a core of every two
    workers, and its setting of malloc, which gives memory back at once, 6 % of their time.
    """
    import dask

    blas = dict.fromkeys(_THREADS_OF_BLAS, threads)
    before = {name: os.environ.get(name) for name in blas}
    settings = {
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "20s",
        "distributed.worker.profile.enabled": False,
        "distributed.nanny.pre-spawn-environ": blas,
    }
    try:
        with dask.config.set(settings):
            yield
    finally:
        # They were set in this process as well, for those that it starts.
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(address, timeout=ANSWER, set_as_default=False, name="lightmatrix")
    # A scheduler of another version may answer nearly anything.
    except Exception as error:
        told = " ".join(str(error).split())[:200]
        raise ClusterError(
            f"{address}: no scheduler of Dask answers ({type(error).__name__}: {told})",
            hint="start one with `dask scheduler`, workers with `dask worker tcp://HOST:8786`, and "
            "give the address that it tells; is a firewall between?",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=ARRIVAL)
        except TimeoutError as error:
            raise ClusterError(
                f"{address}: has no workers", hint=f"start some: dask worker {address}"
            ) from error
        yield client


def _facts(client: Client, address: str) -> list[dict[str, Any]]:
    """What the workers are, if all are of the same making as this process."""
    answers = client.run(about, on_error="return")
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            raise ClusterError(
                f"{address}: worker {worker} has no lightmatrix like this one "
                f"({type(answer).__name__}: {' '.join(str(answer).split())[:200]})",
                hint=SAME,
            )
        differing = _differing(answer["versions"])
        if differing:
            raise ClusterError(f"{address}: worker {worker} has {differing}", hint=SAME)
    return list(answers.values())


def _check_memory(facts: list[dict[str, Any]], memory: int) -> None:
    """Whether all workers of each machine have so many bytes together."""
    for host, count in Counter(fact["host"] for fact in facts).items():
        free = min(fact["available"] for fact in facts if fact["host"] == host)
        if count * memory > free:
            raise ClusterError(
                f"{host}: {count} workers take about {count * memory / 2**30:.2g} GiB of memory, "
                f"{free / 2**30:.2g} GiB are free",
                hint="use fewer workers with more threads each, or --memory for each of them",
            )


def _differing(theirs: Mapping[str, str]) -> str:
    """Which versions of a worker are others than here, in words."""
    pairs: list[tuple[str, Any, str]] = [
        (name, theirs.get(name), own) for name, own in versions().items()
    ]
    return ", ".join(f"{name} {other}, not {own}" for name, other, own in pairs if other != own)


@contextmanager
def _quiet() -> Iterator[None]:
    """Let Dask say nothing by itself: what matters is said by us."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"distributed(\..*)?")
            # Told as if others said it, where the machine is busy.
            warnings.filterwarnings("ignore", message="Creating scratch directories")
            yield
    finally:
        logger.setLevel(level)
