"""`lightmatrix track`: T after each further photograph."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.cli.options import Json, Overwrite, described
from lightmatrix.cli.terminal import answer, judged_json, progress, say
from lightmatrix.errors import InputError, warn
from lightmatrix.files.kinds import STORE
from lightmatrix.files.stacks import ImageStack, natural_order
from lightmatrix.files.writing import check_output
from lightmatrix.rig.devices.folders import NewFiles


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
    frames, lines = capture.frames, list[dict[str, Any]]()
    further = ((k, frames.name(k), capture.select([k])) for k in range(start.count, capture.count))
    try:
        with suppress(KeyboardInterrupt):
            for k, name, one in further if watch is None else _watched(capture, watch, first):
                started = time.perf_counter()
                step = next(tracker.follow(one))
                seconds = time.perf_counter() - started
                shares = {n: float(getattr(step, n).mean()) for n in ("changed", "unknown")}
                line = {"photograph": name, "pattern": k, "missed": step.missed, **shares}
                lines.append({**line, "seconds": seconds})
                if not as_json:
                    named = [f"{100 * lines[-1][n]:.2g} % {n}" for n in ("missed", *shares)]
                    say(f"{name}, pattern {k}: {', '.join(named)}; {seconds:.2f} s")
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


def _watched(
    capture: lm.Capture, folder: Path, first: int | None
) -> Iterator[tuple[int, str, lm.Capture]]:
    """The photographs in a folder, each with its pattern, as they become whole."""
    count, frames = capture.count, capture.frames
    parts = _numbered(Path(frames.name(0)))
    begin = int(parts[1]) if parts and first is None else first or 0
    stack = ImageStack(
        (Path(frames.name(0)),), frames.shape, frames.dtype, grey=len(frames.shape) == 2,
        mosaic=getattr(frames, "mosaic", False),
    )  # fmt: skip
    files, around = NewFiles(folder, lambda item: natural_order(item[0])), None
    last = time.monotonic()
    while time.monotonic() < last + 30:
        found = files.next(lambda file: replace(stack, paths=(*stack.paths, file)).read(1))
        if found is None:
            # No program takes that long over the rest of a file.
            if files.failure is not None and files.failure[1] > 5:
                warn(f"left out: {files.failure[0]}")
                files.pass_over(first=True)
            time.sleep(0.05)
            continue
        file, levels, _ = found
        parts = _numbered(file)
        if parts is None or (around or parts[::2]) != parts[::2]:
            like = "" if around is None else f" between {around[0]!r} and {around[1]!r}"
            warn(f"left out: {file}: has no number{like} in its name, which would say its pattern")
            continue
        number = int(parts[1]) - begin
        # Numbers may go on from those of the capture. Any others are those of another count.
        if number < 0 or (around is None and number >= 2 * count):
            raise InputError(
                f"{file}: is no number of a pattern, as that of the first one is {begin}",
                hint=f"state the number of the first pattern: first={parts[1]}",
            )
        files.suffix, around = file.suffix.lower(), parts[::2]
        one = replace(capture.select([number % count]), frames=ArrayStack(levels[None]))
        yield number % count, str(file), one
        last = time.monotonic()


def _numbered(file: Path) -> tuple[str, ...] | None:
    """The last number in a file's name, between what is around it."""
    match = re.fullmatch("(.*?)([0-9]+)([^0-9]*)", file.stem)
    return match and match.groups()
