"""`lightmatrix track`: T after each further photograph."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described
from lightmatrix.cli.terminal import answer, judged_json, progress, say
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import STORE
from lightmatrix.files.writing import check_output


@described(
    folder=Argument(metavar="CAPTURE", help="A capture folder, or a packed capture."),
    output="The store to write in the end, ending in .zarr.",
    window=Option(
        "-k", "--window", min=8, help="Photographs that T is estimated from, and that slide along."
    ),
    watch=Option(
        metavar="DIR",
        help="Follow a folder of further photographs, those that are there and those that another "
        "program leaves there. Their names end in a number that says the pattern, counted as in "
        "the capture; after the last pattern comes the first. It ends when none comes for half a "
        "minute, or with Ctrl-C.",
        show_default="the photographs of the capture after the window",
    ),
    first=Option(
        min=0,
        help="With --watch, the number in the name of a photograph of the first pattern.",
        show_default="that of the capture's first photograph",
    ),
)
def track(
    folder: Path,
    output: Path,
    window: int = 32,
    watch: Path | None = None,
    first: int | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Let T follow a scene in which things move.

    Rows of T that follow the photographs stay as they are. Those that changed are estimated again,
    and unknown until they predict photographs; `show SCENE.zarr changes` draws them.
    """
    check_output(output, STORE, overwrite=overwrite)
    capture = lm.Capture.open(folder)
    start = capture.select(range(min(window, capture.count)))
    if watch is None and start.count == capture.count:
        hint = f"use a window of less than {capture.count}"
        raise InputError(f"{folder}: has no photographs after the window", hint=hint)
    if watch is not None and not watch.is_dir():
        raise InputError(f"{watch}: no such folder", hint="make it first, or check the name")
    with progress("estimating", "rows") as report:
        tracker = lm.Tracker(start, lm.estimate(start, progress=report))
    lines, offset = list[dict[str, Any]](), start.count if watch is None else 0
    if watch is None:
        steps = tracker.follow(capture.select(range(start.count, capture.count)))
    else:
        steps = tracker.watch(watch, capture, first=first)
    try:
        with suppress(KeyboardInterrupt):
            for step in steps:
                shares = {n: float(getattr(step, n).mean()) for n in ("changed", "unknown")}
                line = {"photograph": step.name, "pattern": step.pattern + offset}
                lines.append({**line, "missed": step.missed, **shares, "seconds": step.seconds})
                if not as_json:
                    named = [f"{100 * lines[-1][n]:.2g} % {n}" for n in ("missed", *shares)]
                    said = f"{step.name}, pattern {step.pattern + offset}: {', '.join(named)}"
                    say(f"{said}; {step.seconds:.2f} s")
    finally:
        # T as far as it got is saved, whatever ends the photographs.
        transport = tracker.transport
        lm.save(output, transport, overwrite=overwrite)
    judged = lm.verdicts(transport)
    result = {"output": output, **judged_json(judged), "photographs": lines, **transport.summary()}
    text = f"{output}: T after {len(lines)} further photographs"
    if not lines:
        text = f"{output}: T of the first {start.count} photographs; no further one was taken in"
    answer(as_json, result, *judged.lines(), text)
