"""`lightmatrix track`: T after each further photograph."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described
from lightmatrix.cli.terminal import answer, progress, say
from lightmatrix.errors import FrameTimeoutError, InputError
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
        help="Follow a folder in which another program leaves further photographs, of the patterns "
        "of the capture in turn. It ends when none comes for half a minute, or with Ctrl-C.",
        show_default="the photographs of the capture after the window",
    ),
)
def track(
    folder: Path,
    output: Path,
    window: int = 32,
    watch: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Let T follow a scene in which things move.

    Rows of T that follow the photographs stay as they are. Those that changed are estimated again,
    and unknown until they predict photographs; `show SCENE.zarr changes` draws them.
    """
    check_output(output, STORE, overwrite=overwrite)
    capture = lm.Capture.open(folder)
    first = capture.select(range(min(window, capture.count)))
    if watch is None and first.count == capture.count:
        hint = f"use a window of less than {capture.count}"
        raise InputError(f"{folder}: has no photographs after the window", hint=hint)
    with progress("estimating", "rows") as report:
        tracker = lm.Tracker(first, lm.estimate(first, progress=report))
    steps = (
        tracker.follow(capture.select(range(first.count, capture.count)))
        if watch is None
        else _watched(tracker, capture, watch)
    )
    lines, started = list[dict[str, Any]](), time.perf_counter()
    try:
        with suppress(KeyboardInterrupt):
            for step in steps:
                seconds, started = time.perf_counter() - started, time.perf_counter()
                shares = {n: float(getattr(step, n).mean()) for n in ("changed", "unknown")}
                lines.append({"missed": step.missed, **shares, "seconds": seconds})
                if not as_json:
                    named = [f"{100 * lines[-1][n]:.2g} % {n}" for n in ("missed", *shares)]
                    say(f"photograph {step.photograph}: {', '.join(named)}; {seconds:.2f} s")
    finally:
        # T as far as it got is saved, whatever ends the photographs.
        lm.save(output, tracker.transport, overwrite=overwrite)
    result = {"output": output, "photographs": lines, **tracker.transport.summary()}
    answer(as_json, result, f"{output}: T after {len(lines)} photographs")


def _watched(tracker: lm.Tracker, capture: lm.Capture, folder: Path) -> Iterator[Any]:
    """Take the files that appear in a folder as photographs of the capture's patterns in turn."""
    exposures = capture.exposures.tolist()
    with (
        closing(lm.open_camera(f"watch:{folder},exposure={exposures[0]}")) as camera,
        suppress(FrameTimeoutError),
    ):
        for k in itertools.cycle(range(capture.count)):
            levels, pattern = camera.get_image(30.0).data, capture.patterns.images(k, k + 1)[0]
            yield tracker.update(levels, pattern, exposure=exposures[k])
