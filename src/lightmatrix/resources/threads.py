"""Threads of this process: how many, what they work on ahead, and what only one computes."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cached_property
from threading import RLock
from typing import Any, Self, TypeVar, overload

from threadpoolctl import ThreadpoolController

S = TypeVar("S")
T = TypeVar("T")


def core_threads() -> int:
    """Threads that the compiled core uses."""
    wanted = os.environ.get("RAYON_NUM_THREADS", "")
    return int(wanted) if wanted.isdecimal() and int(wanted) else os.cpu_count() or 1


_ONE_BLAS_THREAD = ContextVar("one_blas_thread", default=False)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """A context in which NumPy and SciPy multiply matrices on one thread.

    For many small products: more threads would mostly wait for each other, which took half of the
    processor time of `check` on two cores.
    """
    if _ONE_BLAS_THREAD.get():
        # Looking for the libraries once more takes 2 ms, and `check` predicts hundreds of times.
        yield
        return
    controller = ThreadpoolController().select(user_api="blas")
    # Setting what is set would start threads, and take memory, in a forked process.
    limited = any(library["num_threads"] != 1 for library in controller.info())
    entered = _ONE_BLAS_THREAD.set(True)
    try:
        with controller.limit(limits=1) if limited else nullcontext():
            yield
    finally:
        _ONE_BLAS_THREAD.reset(entered)


def work_ahead(
    function: Callable[[S], T], items: Iterable[S], threads: int | None = None
) -> Iterator[T]:
    """The results of a function in order, while threads work on the next items.

    Threads (None: as many as the core uses, at most eight) help where the function decodes images
    or multiplies matrices, which releases Python's lock. They hold at most two results each, and an
    error is raised in its turn. With one thread, or one item, nothing is done ahead.
    """
    # More than eight wait for the disk and for Python's lock.
    workers = min(8, core_threads()) if threads is None else threads
    if workers == 1 or (isinstance(items, Sized) and len(items) <= 1):
        yield from map(function, items)
        return
    pool = ThreadPoolExecutor(workers, "work-ahead")
    waiting: deque[Future[T]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) >= 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        # Items that nobody waits for any more are not begun.
        pool.shutdown(wait=True, cancel_futures=True)


def side_by_side(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """The results of jobs that have nothing to do with each other, which threads run."""
    return list(work_ahead(lambda job: job(), jobs))


class computed_once(cached_property[T]):  # noqa: N801 - a decorator, written like the one it extends
    """A `cached_property` that one thread computes while others wait for it.

    From Python 3.12 on, threads that ask a `cached_property` at the same time all compute it. One
    lock serves all instances, so the function must not wait for threads that ask for the same.
    """

    def __init__(self, function: Callable[[Any], T]) -> None:
        super().__init__(function)
        self._computing = RLock()

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: object, owner: type[Any] | None = None) -> Any:
        """The value, or the property itself if a class is asked."""
        with self._computing:
            return super().__get__(instance, owner)
