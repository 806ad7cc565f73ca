"""Working ahead: threads work on the next items while the result of one is being used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from lightmatrix.resources.threads import core_threads

S = TypeVar("S")
T = TypeVar("T")
# More threads than this wait for the disk and for Python's lock. Chosen by hand.
_MOST_THREADS = 8


def work_ahead(
    function: Callable[[S], T], items: Iterable[S], threads: int | None = None
) -> Iterator[T]:
    """The results of a function in order, while threads work on the next items.

    Threads (None: as many as the core uses, at most eight) help where the function decodes images
    or multiplies matrices, which releases Python's lock. They hold at most two results each, and an
    error is raised in its turn. With one thread, or one item, nothing is done ahead.
    """
    workers = min(_MOST_THREADS, core_threads()) if threads is None else threads
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
