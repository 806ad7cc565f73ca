"""`lightmatrix track`: T after each further photograph."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from itertools import count
from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described, output_option
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.errors import FrameTimeoutError, InputError
from lightmatrix.files.kinds import STORE
from lightmatrix.files.writing import check_output


@described(
    folder=Argument(metavar="CAPTURE", help="A capture folder, or a packed capture."),
    output=output_option("The store to write in the end, ending in .zarr."),
    window=Option(
        "-k",
        "--window",
        help="Photographs that T is estimated from at first, and that slide along.",
        show_default="32, or all of them with --watch",
        min=8,
    ),
    watch=Option(
        metavar="DIR",
        help="Follow a folder in which another program leaves further photographs, under the "
        "patterns of the capture from the first on, again and again. Ends when none comes for half "
        "a minute, or with Ctrl-C.",
        show_default="the capture's own photographs after the window",
    ),
    changes=Option(metavar="FILE", help="Also draw when each camera pixel changed, as a .png."),
)
def track(
    folder: Path,
    output: Path,
    window: int | None = None,
    watch: Path | None = None,
    changes: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Let T follow a scene in which things move.

    Prints a line for each photograph. Rows of T that follow the photographs stay as they are; those
    that changed are estimated again, and unknown until they predict photographs.
    """
    check_output(output, STORE, overwrite=overwrite)
    capture = lm.Capture.open(folder)
    window = min(window or (32 if watch is None else capture.count), capture.count)
    if watch is None and window == capture.count:
        raise InputError(
            f"{folder}: a window of all its {window} photographs", hint="use a smaller --window"
        )
    first = capture.select(range(window))
    with progress("estimating", "rows") as report:
        tracker = lm.Tracker(first, lm.estimate(first, progress=report))
    if watch is None:
        steps = tracker.follow(capture.select(range(window, capture.count)))
    else:
        steps = _watched(tracker, capture, watch)
    lines: list[dict[str, Any]] = []
    started = time.perf_counter()
    try:
        for step in steps:
            seconds, started = time.perf_counter() - started, time.perf_counter()
            line = {
                "photograph": step.photograph,
                "missed": step.missed,
                "changed_share": float(step.changed.mean()),
                "unknown_share": float(step.unknown.mean()),
                "seconds": seconds,
            }
            lines.append(line)
            if not as_json:
                shares = [100 * line[name] for name in ("missed", "changed_share", "unknown_share")]
                say(
                    f"photograph {step.photograph}: missed by {shares[0]:.2g} %, {shares[1]:.2g} % "
                    f"changed, {shares[2]:.2g} % unknown; {seconds:.2f} s"
                )
    except KeyboardInterrupt:
        if not lines:
            raise
    transport = tracker.transport
    lm.save(output, transport, overwrite=overwrite)
    if changes is not None:
        lm.show(transport, "changes", output=changes, overwrite=overwrite)
    if as_json:
        show_json({"output": output, "photographs": lines, **transport.summary()})
        return
    say(f"{output}: T after {len(lines)} photographs")


def _watched(tracker: lm.Tracker, capture: lm.Capture, folder: Path) -> Iterator[Any]:
    """Take the files that appear in a folder as photographs of the capture's patterns in turn."""
    exposures = capture.exposures
    with closing(lm.open_camera(f"watch:{folder},exposure={exposures[0]}")) as camera:
        for number in count():
            k = number % capture.count
            try:
                frame = camera.get_image(timeout=30.0)
            except FrameTimeoutError:
                return
            pattern = capture.patterns.images(k, k + 1)[0]
            yield tracker.update(frame.data, pattern, exposure=float(exposures[k]))
