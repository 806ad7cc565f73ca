"""Tiles side by side: all are kept, progress never falls, and an error stops the others."""

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

from lightmatrix.estimators.work import SolveTile, TilesInMemory, complete
from lightmatrix.progress import Progress
from lightmatrix.transport.checkpoint import ROWS
from lightmatrix.transport.sparse_rows import SparseRows

SPANS = [(0, 3), (3, 4), (4, 9), (9, 10), (12, 20)]


def solve_tiles(
    solve_tile: SolveTile,
    spans: list[tuple[int, int]],
    together: int,
    report: Callable[[int], None] = lambda done: None,
    kept: TilesInMemory | None = None,
) -> None:
    """Complete a work of one step with these tiles."""
    work: Any = SimpleNamespace(
        capture=SimpleNamespace(rows=20),
        steps={ROWS: ()},
        tiles=lambda step, parts: iter(spans),
        prepare=lambda step, read: solve_tile,
        together=together,
        solved=lambda step, done: done,
    )
    complete(work, kept or TilesInMemory(), lambda done, total: report(done))


def rows(start: int, stop: int, progress: Progress) -> SparseRows:
    for done in range(stop - start):
        progress(done, stop - start)
        time.sleep(0.002)
    return SparseRows(csr_array((stop - start, 2)), np.arange(start, stop)[:, None])


@pytest.mark.parametrize("together", [1, 2, 3])
def test_every_tile_is_kept_and_progress_never_falls(together: int) -> None:
    kept, reported = TilesInMemory(), list[int]()
    threads = set[int]()

    def report(done: int) -> None:
        threads.add(threading.get_ident())
        reported.append(done)

    solve_tiles(rows, SPANS, together, report, kept)
    assert kept.spans() == SPANS
    for (start, stop), part in kept.rows[ROWS].items():
        assert part.background.ravel().tolist() == list(range(start, stop))
    assert reported == sorted(reported)
    assert max(reported) <= 20
    # Progress bars of other programs may not be used from other threads.
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("together", [1, 2])
def test_after_an_error_finished_tiles_are_kept_and_running_ones_end(together: int) -> None:
    kept, ended = TilesInMemory(), list[int]()

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
        solve_tiles(solve, SPANS, together, kept=kept)
    assert (0, 3) in kept.spans()
    assert (9, 10) not in kept.spans()
    # The tile that would have run for ten seconds has ended, and was not kept.
    assert 3 in ended
    assert ((3, 4) in kept.spans()) == (together == 1)


def test_ctrl_c_ends_running_tiles() -> None:
    def endless(start: int, stop: int, progress: Progress) -> SparseRows:
        while True:
            progress(0, 1)
            time.sleep(0.001)

    def interrupt(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_tiles(endless, SPANS, 2, interrupt)
