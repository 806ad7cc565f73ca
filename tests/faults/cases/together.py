"""C: two runs at once, runs that were killed, locks of the dead and of the living."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..case import Case, Command, Ran, Scenario
from ..checks import holds, same_matrix
from ..put import copy, remove, text
from ..work import PLAIN, SLOWLY

SLOW = f"estimate capture {SLOWLY} -o new.zarr"
OTHER = f"estimate lit {SLOWLY} -o new.zarr"
PARTIAL = "new.zarr.partial"
# What a run is stopped at.
TILES, ANYTHING = "tiles", "anything"
# A write that stops in the middle: many patterns.
LONG = "patterns bernoulli -k 4000 --size 32x32 -o new"
# Runs in the background of a shell ignore Ctrl-C, and what they start inherits that.
_RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from lightmatrix.cli import main
sys.exit(main())
"""


@contextmanager
def started(folder: Path, command: str) -> Iterator[subprocess.Popen[str]]:
    """A command that runs beside the test."""
    words = [sys.executable, "-c", _RUN, *command.split()]
    process = subprocess.Popen(
        words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
        process.communicate()


@contextmanager
def stopped_at_work(
    folder: Path, command: str, sign: str = TILES
) -> Iterator[subprocess.Popen[str]]:
    """A command that was stopped with work behind it and work ahead of it.

    On a busy machine it may be over before it is stopped; it is then started again.
    """
    before = set(_names(folder))
    for _ in range(5):
        with started(folder, command) as process:
            if _stopped_in_time(process, folder, before, sign):
                yield process
                return
        for name in set(_names(folder)) - before:
            remove(name)(folder)
    raise TimeoutError(f"it was never stopped at {sign}")


def _stopped_in_time(
    process: subprocess.Popen[str], folder: Path, before: set[str], sign: str
) -> bool:
    """Stop it as soon as it has finished tiles, or anything new lies there but its lock.

    Between the lock and the first file a Ctrl-C may leave the lock, which binds nobody: the kernel
    has let go of it, and the next run takes it over.
    """

    def begun() -> bool:
        if sign == TILES:
            return len(_names(folder / PARTIAL)) > 5
        return any(not name.endswith(".lock") for name in set(_names(folder)) - before)

    end = time.monotonic() + 90
    while time.monotonic() < end and process.poll() is None:
        if begun():
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.01)
            return process.poll() is None and begun()
        time.sleep(0.001)
    return False


def _names(place: Path) -> list[str]:
    try:
        return os.listdir(place)
    except OSError:
        return []


def _second_beside(second: str, sign: str = TILES) -> Scenario:
    """A run stopped at work, a second one into the same output, then the first to its end."""

    def scenario(folder: Path, run: Command) -> Ran:
        with stopped_at_work(folder, SLOW, sign) as first:
            ran = run(second)
            first.send_signal(signal.SIGCONT)
            _, words = first.communicate(timeout=60)
            if first.returncode != 0:
                return Ran(1, "", f"the first run ended with {first.returncode}: {words}")
        return ran

    return scenario


def _killed(command: str, again: str, sign: str, with_signal: int = signal.SIGKILL) -> Scenario:
    """A run killed at work, then the right command."""

    def scenario(folder: Path, run: Command) -> Ran:
        with stopped_at_work(folder, command, sign) as first:
            first.send_signal(with_signal)
            first.send_signal(signal.SIGCONT)
            first.wait(30)
        return run(again)

    return scenario


def _interrupted(folder: Path, run: Command) -> Ran:
    """Ctrl-C at work: its own exit code and words."""
    with stopped_at_work(folder, SLOW) as first:
        first.send_signal(signal.SIGINT)
        first.send_signal(signal.SIGCONT)
        _, words = first.communicate(timeout=30)
        return Ran(first.returncode, "", words)


def _at_once(folder: Path, run: Command) -> Ran:
    """Two at the same moment: one wins, the other is refused, and what lies there is whole."""
    with started(folder, SLOW) as first, started(folder, OTHER) as second:
        ends = []
        for process in (first, second):
            _, words = process.communicate(timeout=60)
            ends.append((process.returncode, words))
    codes = sorted(code for code, _ in ends)
    refused = next((words for code, words in ends if code == 2), "")
    # Where one was over before the other began, the second finds an output: refused as well.
    return Ran(2 if codes == [0, 2] else 0, f"exit codes {codes}", refused)


def _either(folder: Path, ran: Ran) -> str | None:
    mine = same_matrix("new.zarr", "slow.zarr")(folder, ran)
    return mine and same_matrix("new.zarr", "lit.zarr")(folder, ran)


def _of_lit(folder: Path) -> None:
    from ..zygote import run_command

    run_command(f"estimate lit {SLOWLY} -o lit.zarr", folder)


SAME = same_matrix("new.zarr", "slow.zarr")
MADE = ("new.zarr", PARTIAL)

# What its cases need of the work folder.
NEEDS = ("T.npz", "patterns", "capture", "lit", "slow.zarr", "scene.zarr")

CASES = [
    Case(
        "two estimates of one capture into one output",
        SLOW,
        "new.zarr: is being written by another process",
        scenario=_second_beside(SLOW),
        leaves=MADE,
        check=SAME,
    ),
    Case(
        "two estimates of two captures into one output",
        OTHER,
        "new.zarr",
        scenario=_second_beside(OTHER),
        leaves=MADE,
        check=SAME,
    ),
    Case(
        "a second estimate with --overwrite beside a running one",
        f"{OTHER} --overwrite",
        "new.zarr",
        scenario=_second_beside(f"{OTHER} --overwrite"),
        leaves=MADE,
        check=SAME,
    ),
    Case(
        "a second estimate by another path to one output",
        f"{OTHER.replace('new.zarr', '../work/new.zarr')}",
        "new.zarr",
        scenario=_second_beside(OTHER.replace("new.zarr", "../work/new.zarr")),
        leaves=MADE,
        check=SAME,
    ),
    Case(
        "two estimates at the same moment",
        SLOW,
        (),
        _of_lit,
        scenario=_at_once,
        leaves=MADE,
        makes=MADE,
        check=_either,
    ),
    Case(
        "an estimate killed at work goes on",
        SLOW,
        code=0,
        scenario=_killed(SLOW, SLOW, TILES),
        makes=("new.zarr",),
        check=SAME,
    ),
    Case(
        "an estimate terminated at work goes on",
        SLOW,
        code=0,
        scenario=_killed(SLOW, SLOW, TILES, signal.SIGTERM),
        makes=("new.zarr",),
        check=SAME,
    ),
    Case(
        "an estimate interrupted at work",
        SLOW,
        "kept",
        code=130,
        scenario=_interrupted,
        makes=MADE,
        then=SLOW,
    ),
    Case(
        "an estimate interrupted at work goes on",
        SLOW,
        code=0,
        scenario=_killed(SLOW, SLOW, TILES, signal.SIGINT),
        makes=("new.zarr",),
        check=SAME,
    ),
    Case(
        "patterns killed at work are swept by the next run",
        LONG,
        code=0,
        scenario=_killed(LONG, "patterns bernoulli -k 4 --size 8x8 -o new", ANYTHING),
        makes=("new",),
        check=holds("new/pattern_0003.png"),
    ),
    Case(
        "patterns interrupted at work leave nothing",
        LONG,
        code=0,
        scenario=_killed(LONG, "info scene.zarr", ANYTHING, signal.SIGINT),
        makes=(),
    ),
    Case(
        "patterns terminated at work leave nothing, or are swept",
        LONG,
        code=0,
        scenario=_killed(
            LONG, "patterns bernoulli -k 4 --size 8x8 -o new", ANYTHING, signal.SIGTERM
        ),
        makes=("new",),
    ),
    Case(
        "a replacement interrupted at work leaves the old",
        f"{LONG} --overwrite",
        code=0,
        prepare=copy("patterns", "new"),
        scenario=_killed(
            f"{LONG} --overwrite", "simulate T.npz --patterns new -o shown", ANYTHING, signal.SIGINT
        ),
        makes=("shown",),
    ),
    Case(
        "somebody's own lock file",
        f"{PLAIN} -o new.zarr",
        (),
        text("new.zarr.lock", "mine"),
        code=(0, 2),
        makes=("new.zarr",),
    ),
    Case(
        "somebody's own hidden lock file",
        f"{PLAIN} -o new.zarr",
        (),
        text(".new.zarr.lock", "mine"),
        code=(0, 2),
        makes=("new.zarr",),
    ),
]
