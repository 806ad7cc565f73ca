"""Tiles side by side: all are kept, progress never falls, and an error stops the others."""

import threading
import time

import numpy as np
import pytest
from scipy.sparse import csr_array

from lightmatrix.estimators.side_by_side import solve_tiles
from lightmatrix.solvers.loop import Progress
from lightmatrix.transport.sparse_rows import SparseRows

SPANS = [(0, 3), (3, 4), (4, 9), (9, 10), (12, 20)]


def rows(start: int, stop: int, progress: Progress) -> SparseRows:
    for done in range(stop - start):
        progress(done, stop - start)
        time.sleep(0.002)
    return SparseRows(csr_array((stop - start, 2)), np.arange(start, stop)[:, None])


@pytest.mark.parametrize("together", [1, 2, 3])
def test_every_tile_is_kept_and_progress_never_falls(together: int) -> None:
    kept, reported = dict[tuple[int, int], SparseRows](), list[int]()
    threads = set[int]()

    def report(done: int) -> None:
        threads.add(threading.get_ident())
        reported.append(done)

    solve_tiles(rows, SPANS, together, kept.__setitem__, report)
    assert sorted(kept) == SPANS
    for (start, stop), part in kept.items():
        assert part.background.ravel().tolist() == list(range(start, stop))
    assert reported == sorted(reported)
    assert max(reported) <= sum(stop - start for start, stop in SPANS)
    # Progress bars of other programs may not be used from other threads.
    assert threads == {threading.get_ident()}


def test_two_tiles_are_solved_at_a_time() -> None:
    meeting = threading.Barrier(2, timeout=10)

    def meet(start: int, stop: int, progress: Progress) -> SparseRows:
        meeting.wait()
        return rows(start, stop, progress)

    solve_tiles(meet, SPANS[:4], 2, lambda span, part: None, lambda done: None)


def test_one_tile_is_solved_by_the_thread_that_asks() -> None:
    threads = list[int]()

    def solve(start: int, stop: int, progress: Progress) -> SparseRows:
        threads.append(threading.get_ident())
        return rows(start, stop, progress)

    solve_tiles(solve, SPANS[:1], 2, lambda span, part: None, lambda done: None)
    assert threads == [threading.get_ident()]


@pytest.mark.parametrize("together", [1, 2])
def test_after_an_error_finished_tiles_are_kept_and_running_ones_end(together: int) -> None:
    kept, ended = list[tuple[int, int]](), list[int]()

    def solve(start: int, stop: int, progress: Progress) -> SparseRows:
        if start == 4:
            raise ValueError("a tile fails")
        try:
            for _ in range(10_000 if start == 3 and together == 2 else 1):
                progress(0, stop - start)
                time.sleep(0.001)
        finally:
            ended.append(start)
        return rows(start, stop, progress)

    with pytest.raises(ValueError, match="a tile fails"):
        solve_tiles(solve, SPANS, together, lambda span, part: kept.append(span), lambda done: None)
    assert (0, 3) in kept
    assert (9, 10) not in kept
    # The tile that would have run for ten seconds has ended, and was not kept.
    assert 3 in ended
    assert ((3, 4) in kept) == (together == 1)


def test_ctrl_c_ends_running_tiles() -> None:
    def endless(start: int, stop: int, progress: Progress) -> SparseRows:
        while True:
            progress(0, 1)
            time.sleep(0.001)

    def interrupt(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_tiles(endless, SPANS, 2, lambda span, part: None, interrupt)
