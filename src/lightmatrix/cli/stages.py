"""Progress of work at a rig: one bar at a time, whatever it is busy with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from lightmatrix.cli.terminal import progress

# Between the stages that count something.
_BETWEEN = "looking at the rig"


class Stages:
    """Shows the bar of the stage that was told of last; made by `stages`."""

    def __init__(self, shown: ExitStack) -> None:
        self._shown = shown
        self._what = ""
        self._bar: Callable[..., None]
        self._begin(_BETWEEN, "looks")

    def measured(self, part: str, done: int, total: int) -> None:
        """A part of the rig is being measured."""
        self._tell(f"measuring {part}", "looks", done, total)
        if done == total:
            self._begin(_BETWEEN, "looks")

    def photographed(self, step: Any) -> None:
        """A frame was taken; see `lightmatrix.live.session.Step`."""
        note = f"{100 * step.clipped:.1f} % clipped, {step.check}"
        self._tell("photographing", "frames", step.done, step.total, note)

    def _tell(self, what: str, unit: str, done: int, total: int, note: str = "") -> None:
        if what != self._what:
            self._begin(what, unit)
        self._bar(done, total, note)

    def _begin(self, what: str, unit: str) -> None:
        # Two bars at once would write over each other.
        self._shown.close()
        self._what, self._bar = what, self._shown.enter_context(progress(what, unit))


@contextmanager
def stages() -> Iterator[Stages]:
    """Bars with rate and time left on a terminal; silent elsewhere."""
    with ExitStack() as shown:
        yield Stages(shown)
