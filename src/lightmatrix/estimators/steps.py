"""Estimates as steps of tiles: what is solved after what, here or by other processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

from lightmatrix.capture.capture import Capture
from lightmatrix.store import ROWS
from lightmatrix.store.tiles import Span, unfinished_spans
from lightmatrix.transport.sparse_rows import SparseRows

Progress = Callable[[int, int], None]
# Solves the rows start..stop.
SolveTile = Callable[[int, int], SparseRows]
# All rows of a step that is whole.
Found = Callable[[str], SparseRows]

# Steps are not cut into smaller tiles than this for the sake of their number.
LEAST_TILE = 64


class Work(Protocol):
    """An estimate as steps, each of tiles of rows: what is solved, and after what.

    It may travel to other processes, so it holds nothing but the capture and parameters.
    """

    @property
    def capture(self) -> Capture:
        """What is estimated from."""

    @property
    def steps(self) -> Mapping[str, tuple[str, ...]]:
        """The steps by their names, each with those that must be whole before; `ROWS` is the last.

        A name has lower case letters, digits and hyphens.
        """

    def ranges(self, step: str, parts: int = 1, *, shrinking: bool = False) -> Iterator[Span]:
        """Tiles of a step, in order: its rows start..stop; where it may be, so many or more.

        `shrinking` ones get smaller towards the end: those who solve them end together.
        """

    def begin(self, step: str, found: Found) -> SolveTile:
        """What comes before the first tile of a step, and gives what solves its rows start..stop.

        It may ask `found` for the rows of the steps that come before. A row depends on them, on its
        samples and on nothing else, whichever tile it is in.
        """

    def report(self, step: str, start: int = 0) -> Progress | None:
        """What is told of the rows of a step from `start` on; None if nobody listens."""

    def silent(self) -> Work:
        """The same without anybody who listens."""


@dataclass(frozen=True, eq=False)
class OneStep(ABC):
    """A `Work` of one step, whose rows depend on their own samples alone."""

    capture: Capture
    progress: Progress | None

    @property
    def steps(self) -> Mapping[str, tuple[str, ...]]:
        """The result alone."""
        return {ROWS: ()}

    @abstractmethod
    def ranges(self, step: str, parts: int = 1, *, shrinking: bool = False) -> Iterator[Span]:
        """Tiles of rows, in order."""

    @abstractmethod
    def solve(self, start: int, stop: int) -> SparseRows:
        """The rows start..stop."""

    def begin(self, step: str, found: Found) -> SolveTile:
        """What solves rows; nothing comes before."""
        return self.solve

    def report(self, step: str, start: int = 0) -> Progress | None:
        """What is told of the rows from `start` on; None if nobody listens."""
        told, total = self.progress, self.capture.rows
        return None if told is None else lambda done, _: told(start + done, total)

    def silent(self) -> Self:
        """The same without anybody who listens."""
        return replace(self, progress=None)


class Tiles(Protocol):
    """Finished tiles of all steps; a `Checkpoint`, or `InMemory`."""

    def spans(self, step: str = ROWS) -> list[Span]:
        """Rows of the finished tiles of a step, in order; none overlap."""

    def write(self, start: int, stop: int, rows: SparseRows, step: str = ROWS) -> None:
        """Keep a finished tile."""

    def read(self, step: str) -> SparseRows:
        """All tiles of a step, joined."""

    def forget(self, step: str) -> None:
        """Throw away the tiles of a step."""


@dataclass(frozen=True, eq=False)
class InMemory:
    """Finished tiles where no output was asked for."""

    tiles: dict[str, dict[Span, SparseRows]] = field(default_factory=dict)

    def spans(self, step: str = ROWS) -> list[Span]:
        """Rows of the finished tiles of a step, in order."""
        return sorted(self.tiles.get(step, {}))

    def write(self, start: int, stop: int, rows: SparseRows, step: str = ROWS) -> None:
        """Keep a finished tile."""
        self.tiles.setdefault(step, {})[start, stop] = rows

    def read(self, step: str) -> SparseRows:
        """All tiles of a step, joined."""
        found = self.tiles[step]
        return SparseRows.joined([found[span] for span in sorted(found)])

    def forget(self, step: str) -> None:
        """Throw away the tiles of a step."""
        self.tiles.pop(step, None)


SolveStep = Callable[[Work, str, list[Span]], None]


def complete(
    work: Work,
    tiles: Tiles,
    step: str = ROWS,
    *,
    parts: int = 1,
    solve: SolveStep | None = None,
) -> None:
    """Solve what is missing of a step, and of those before it.

    What no step asks for any more is thrown away meanwhile.

    Parameters
    ----------
    work : Work
    tiles : Tiles
        Those that are finished, and where others are put.
    step : str
    parts : int
        Into how many tiles a step is cut at least.
    solve : callable, optional
        Solves tiles of a step and keeps them; None: here, one after the other.
    """
    missing = unfinished_spans(work.ranges(step, parts, shrinking=True), tiles.spans(step))
    if not missing:
        return
    for before in work.steps[step]:
        complete(work, tiles, before, parts=parts, solve=solve)
    if solve is not None:
        solve(work, step, missing)
    else:
        solve_tile = work.begin(step, tiles.read)
        for start, stop in missing:
            tiles.write(start, stop, solve_tile(start, stop), step)
    # Steps that only this one asks for are done with.
    for before in work.steps[step]:
        if [name for name, needs in work.steps.items() if before in needs] == [step]:
            tiles.forget(before)


def cut(rows: int, most: int, parts: int = 1, shrinking: bool = False) -> Iterator[Span]:
    """Rows in tiles of at most so many; in so many or more, alike or shrinking, see `Work`."""
    start, even = 0, -(-rows // parts)
    while start < rows:
        size = even
        if shrinking and parts > 1:
            # A share of what is left, not below half of an equal part.
            size = max(-(-even // 2), -(-2 * (rows - start) // max(4, parts)))
        stop = min(rows, start + max(1, min(most, max(LEAST_TILE, size))))
        yield start, stop
        start = stop
