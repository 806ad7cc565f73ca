"""Reading ahead: threads read and decode the next files while one is being used."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")
# More threads than this wait for the disk and for Python's lock. Chosen by hand.
_MOST_THREADS = 8


def read_ahead(
    read: Callable[[S], T], items: Iterable[S], threads: int | None = None
) -> Iterator[T]:
    """The results of `read` in order, while threads work on the next items; 1 reads nothing ahead.

    Threads (None: one a core, at most eight) help since zlib and Pillow decode without Python's
    lock. They hold at most two results each, and an error is raised in its turn.
    """
    workers = min(_MOST_THREADS, os.cpu_count() or 1) if threads is None else threads
    if workers == 1:
        yield from map(read, items)
        return
    pool = ThreadPoolExecutor(workers, "read-ahead")
    waiting: deque[Future[T]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(read, item))
            if len(waiting) >= 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        # Items that nobody waits for any more are not begun.
        pool.shutdown(wait=True, cancel_futures=True)
