"""An estimate as work: steps, each of tiles of rows, solved here or by other processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from threading import Event
from typing import Protocol

from lightmatrix.capture.capture import Capture
from lightmatrix.progress import Progress
from lightmatrix.transport.checkpoint import ROWS, Checkpoint, Span, unfinished_spans
from lightmatrix.transport.sparse_rows import SparseRows

# Solves the rows start..stop of a step, and reports how many of them are done.
SolveTile = Callable[[int, int, Progress], SparseRows]
# Reads all rows of a finished step by its name.
ReadStep = Callable[[str], SparseRows]

# Bytes of working memory of the tiles that are solved side by side. Half a gigabyte is chosen by
# hand: it holds enough rows to keep all cores busy, and lies well below the 4 GiB that any estimate
# may take.
TILE_BYTES = 512 << 20
# Rows of the smallest tile that a step is cut into so that every worker gets some. Chosen by hand:
# smaller tiles cost more to hand out than to solve.
LEAST_TILE = 64


class Work(ABC):
    """An estimate as steps, each of tiles of rows: what is solved, and after what.

    It may travel to other processes, so it holds only the capture and parameters. Unless methods
    say so, it has one step, whose rows depend on their own samples alone.
    """

    # The capture that T is estimated from.
    capture: Capture

    @property
    def steps(self) -> Mapping[str, tuple[str, ...]]:
        """The steps by name, each with the steps that must be finished before it.

        No step comes before those that it needs. The last one is `ROWS`, the result. A name has
        lower case letters, digits and hyphens.
        """
        return {ROWS: ()}

    @abstractmethod
    def tiles(self, step: str, parts: int = 1) -> Iterator[Span]:
        """The rows start..stop of the tiles of a step, in order.

        There are at least `parts` tiles where the step can be cut so. They get smaller towards the
        end, so that all workers finish at about the same time.
        """

    @abstractmethod
    def prepare(self, step: str, read: ReadStep) -> SolveTile:
        """Prepare a step, and return the function that solves its rows start..stop.

        It may `read` the rows of the steps before. A row depends on these, on its samples and on
        nothing else, whichever tile it is in.
        """

    @property
    def together(self) -> int:
        """How many tiles are solved side by side in one process; each takes all cores."""
        return 1

    def solved(self, step: str, done: int) -> int:
        """How many rows of the estimate count as solved after `done` rows of a step."""
        return done


class WorkerPool(Protocol):
    """Other processes that solve tiles, which `finished` keeps."""

    @property
    def parts(self) -> int: ...

    def solve(
        self,
        work: Work,
        step: str,
        spans: list[Span],
        finished: Checkpoint | TilesInMemory,
        report: Callable[[int], None],
    ) -> None: ...


@dataclass(frozen=True, eq=False)
class TilesInMemory:
    """Finished tiles of an estimate without an output; does what a `Checkpoint` does."""

    rows: dict[str, dict[Span, SparseRows]] = field(default_factory=dict)

    def spans(self, step: str = ROWS) -> list[Span]:
        """Rows of the finished tiles of a step, in order."""
        return sorted(self.rows.get(step, {}))

    def write(self, start: int, stop: int, rows: SparseRows, step: str = ROWS) -> None:
        """Keep a finished tile."""
        self.rows.setdefault(step, {})[start, stop] = rows

    def read(self, step: str) -> SparseRows:
        """All tiles of a step, joined."""
        tiles = self.rows[step]
        spans = sorted(tiles)
        size = spans[-1][1], sum(tile.coefficients.nnz for tile in tiles.values())
        # Each is thrown away as soon as it is copied.
        whole = SparseRows.joined(map(tiles.pop, spans), size)
        tiles[0, whole.count] = whole
        return whole

    def forget(self, step: str) -> None:
        """Throw away the tiles of a step."""
        self.rows.pop(step, None)


def complete(
    work: Work,
    finished: Checkpoint | TilesInMemory,
    progress: Progress | None = None,
    pool: WorkerPool | None = None,
) -> None:
    """Solve the missing tiles of an estimate; `finished` keeps each at once.

    `progress` is always called in this thread.
    """
    parts = 1 if pool is None else pool.parts
    missing: dict[str, list[Span]] = {}
    # From the result backwards: a step is needed if a step with missing tiles follows from it.
    for step in reversed(list(work.steps)):
        if step == ROWS or any(step in work.steps[later] for later in missing):
            tiles = work.tiles(step, parts)
            if spans := unfinished_spans(tiles, finished.spans(step)):
                missing[step] = spans
    for step in reversed(list(missing)):
        spans = missing[step]
        # What an earlier run has finished counts as well.
        done = max(stop for _, stop in spans) - sum(stop - start for start, stop in spans)

        def report(rows: int, _: int = 0, step: str = step, already: int = done) -> None:
            if progress is not None:
                progress(work.solved(step, already + rows), work.capture.rows)

        if pool is not None:
            pool.solve(work, step, spans, finished, report)
        else:
            solve_tile = work.prepare(step, finished.read)
            if min(work.together, len(spans)) > 1:
                keep = partial(finished.write, step=step)
                _solve_side_by_side(solve_tile, spans, work.together, keep, report)
            else:
                # This thread solves, too: others would only delay small estimates.
                for start, stop in spans:
                    note = partial(report, already=done)
                    finished.write(start, stop, solve_tile(start, stop, note), step)
                    done += stop - start
            # Its memory is free before the next step is prepared.
            del solve_tile
        for before in work.steps[step]:
            if [name for name, needed in work.steps.items() if before in needed] == [step]:
                finished.forget(before)


class _Stopped(Exception):  # noqa: N818 - nobody sees it; it ends a tile that nobody waits for
    """Another tile failed, or the user stopped the estimate."""


def _solve_side_by_side(
    solve_tile: SolveTile, spans: list[Span], together: int,
    keep: Callable[[int, int, SparseRows], None], report: Callable[[int], None],
) -> None:  # fmt: skip
    """Solve tiles, `together` of them at a time, and `keep` each at once.

    While the core solves the rows of one tile on all cores, Python prepares those of another: so no
    core waits for the main thread.
    """
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
                # A person does not notice that progress is reported every 0.05 s only.
                for ended in wait(running, 0.05, FIRST_COMPLETED).done:
                    start, stop = running.pop(ended)
                    keep(start, stop, ended.result())
                    rows_done[start, stop] = stop - start
                report(sum(rows_done.values()))
        finally:
            # Tiles that still run end at their next report.
            stopped.set()


def cut_rows(rows: int, most: int, parts: int = 1) -> Iterator[Span]:
    """Cut rows into tiles of at most `most`, in `parts` or more; see `Work.tiles`."""
    start, even = 0, -(-rows // parts)
    while start < rows:
        size = even
        if parts > 1:
            # A share of the rows that remain, but at least half of an equal part.
            size = max(-(-even // 2), -(-2 * (rows - start) // max(4, parts)))
        stop = min(rows, start + max(1, min(most, max(LEAST_TILE, size))))
        yield start, stop
        start = stop
