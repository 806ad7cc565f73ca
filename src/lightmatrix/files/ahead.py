"""Reading ahead: the next files are read and decoded by threads while one is looked at."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")
# Beyond that, the disk and NumPy's lock are what is waited for.
_MOST_THREADS = 8


def read_ahead(
    read: Callable[[S], T], items: Iterable[S], threads: int | None = None
) -> Iterator[T]:
    """What a function gives for each item, in their order, some of them ahead by threads.

    Decoding PNG and TIFF is zlib's and Pillow's work, which threads share. No more than two results
    a thread are held, and an error is raised in its turn, as without threads.

    Parameters
    ----------
    read : callable
        Reads one; may be called from any thread.
    items : iterable
        What to read: files, or the numbers of frames.
    threads : int, optional
        None takes one a core, eight at most. With 1 nothing is read ahead.
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
        # What nobody waits for any more is not begun.
        pool.shutdown(wait=True, cancel_futures=True)
