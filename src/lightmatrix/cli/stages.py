"""Progress of a rig: one bar at a time for measuring and photographing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from lightmatrix.cli.terminal import progress

# Title of the bar between the stages that count something.
_BETWEEN = "looking at the rig"


class Stages:
    """Shows the bar of the latest stage; made by `stages`."""

    def __init__(self, shown: ExitStack) -> None:
        self._shown = shown
        self._title = ""
        self._bar: Callable[..., None]
        self._begin(_BETWEEN, "looks")

    def measured(self, part: str, done: int, total: int) -> None:
        """Progress of measuring a part of the rig."""
        self._update(f"measuring {part}", "looks", done, total)
        if done == total:
            self._begin(_BETWEEN, "looks")

    def photographed(self, step: Any) -> None:
        """Progress of a capture after a frame, a `lightmatrix.live.session.Step`."""
        note = f"{100 * step.clipped:.1f} % clipped, {step.check}"
        self._update("photographing", "frames", step.done, step.total, note)

    def _update(self, title: str, unit: str, done: int, total: int, note: str = "") -> None:
        if title != self._title:
            self._begin(title, unit)
        self._bar(done, total, note)

    def _begin(self, title: str, unit: str) -> None:
        # Two bars at once would overwrite each other.
        self._shown.close()
        self._title, self._bar = title, self._shown.enter_context(progress(title, unit))


@contextmanager
def stages() -> Iterator[Stages]:
    """Show bars with rate and time left on a terminal, and nothing elsewhere."""
    with ExitStack() as shown:
        yield Stages(shown)
