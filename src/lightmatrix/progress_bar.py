"""Progress bars on a terminal and in notebooks."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich import progress as bars
from rich.console import Console
from rich.text import Text

# Progress bars compute rate and time left from this many last seconds. Chosen by hand: the stages
# of an estimate differ in pace, and with a few seconds the time left would jump at each of them.
_STEADY_SECONDS = 300.0
# Characters that would move the cursor or change colours. Tabs and line ends are fine.
_CONTROLS = dict.fromkeys((*range(9), *range(11, 32), 127), "\N{REPLACEMENT CHARACTER}")


@contextmanager
def progress_bar(what: str, unit: str, console: Console | None = None) -> Iterator[Any]:
    """Show a bar where somebody looks; yields a callback of (done, total[, note])."""
    if console is None and not (sys.stderr.isatty() or "ipykernel" in sys.modules):
        yield lambda done, total, note="": None
        return
    console = console or Console(stderr=True)
    columns = (
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        _Rate(),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.fields[note]}", markup=False),
    )
    bar_of = bars.Progress(
        *columns, console=console, transient=True, speed_estimate_period=_STEADY_SECONDS
    )
    with bar_of as bar:
        task = bar.add_task(visible(what), total=None, unit=unit, note="")
        yield lambda done, total, note="": bar.update(
            task, completed=done, total=total, note=visible(note)
        )


class _Rate(bars.ProgressColumn):
    def render(self, task: bars.Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{_short(speed)} {task.fields['unit']}/s")


def _short(value: float) -> str:
    """A number with a letter for its thousands: 12.3 k."""
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.1f} {letter}"
    return f"{value:.1f}"


def visible(text: str) -> str:
    """Text without control characters."""
    return text.translate(_CONTROLS)
