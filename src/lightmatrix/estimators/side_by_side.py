"""Solves tiles in this process, several side by side.

While the core solves the rows of one tile on all cores, Python prepares those of another: so no
core waits for the main thread.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from threading import Event

from lightmatrix.solvers.loop import Progress
from lightmatrix.store.checkpoint import Span
from lightmatrix.transport.sparse_rows import SparseRows

# Solves the rows start..stop of a step, and reports how many of them are done.
SolveTile = Callable[[int, int, Progress], SparseRows]

# Seconds between two reports of progress. A person does not notice the delay.
_PATIENCE = 0.05


class _Stopped(Exception):  # noqa: N818 - nobody sees it; it ends a tile that nobody waits for
    """Another tile failed, or the user stopped the estimate."""


def solve_tiles(
    solve_tile: SolveTile,
    spans: list[Span],
    together: int,
    keep: Callable[[Span, SparseRows], None],
    report: Callable[[int], None],
) -> None:
    """Solve tiles, `together` of them at a time, and `keep` each at once.

    `report` is called with the rows that are done, always in this thread. Where there is one tile,
    or one at a time, this thread solves, too: others would only delay small estimates.
    """
    if min(together, len(spans)) == 1:
        _solve_in_turn(solve_tile, spans, keep, report)
        return
    stopped, rows_done = Event(), dict.fromkeys(spans, 0)

    def solve(span: Span) -> SparseRows:
        def note(rows: int, _: int) -> None:
            if stopped.is_set():
                raise _Stopped
            rows_done[span] = rows

        return solve_tile(*span, note)

    waiting, running = iter(spans), dict[Future[SparseRows], Span]()
    with ThreadPoolExecutor(together) as pool:
        try:
            while True:
                for span in islice(waiting, together - len(running)):
                    running[pool.submit(solve, span)] = span
                if not running:
                    return
                for ended in wait(running, _PATIENCE, FIRST_COMPLETED).done:
                    start, stop = running.pop(ended)
                    keep((start, stop), ended.result())
                    rows_done[start, stop] = stop - start
                report(sum(rows_done.values()))
        finally:
            # Tiles that still run end at their next report.
            stopped.set()


def _solve_in_turn(
    solve_tile: SolveTile,
    spans: list[Span],
    keep: Callable[[Span, SparseRows], None],
    report: Callable[[int], None],
) -> None:
    before = 0

    def note(rows: int, _: int) -> None:
        report(before + rows)

    for start, stop in spans:
        keep((start, stop), solve_tile(start, stop, note))
        before += stop - start
