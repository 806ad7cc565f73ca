"""Two runs at once, runs that were killed, locks of the dead and of the living."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from .case import Case, Scenario, bear
from .checks import holds, same_matrix
from .put import copy, remove, text
from .run import HANG, Command, Ran, run
from .work import PLAIN, SLOWLY

NEEDS = ("T.npz", "patterns", "capture", "lit", "slow.zarr", "scene.zarr")
SLOW = f"estimate capture {SLOWLY} -o new.zarr"
OTHER = f"estimate lit {SLOWLY} -o new.zarr"
PARTIAL = "new.zarr.partial"
MADE = ("new.zarr", PARTIAL)
SAME = same_matrix("new.zarr", "slow.zarr")
# A write that stops in the middle: many patterns.
LONG = "patterns bernoulli -k 4000 --size 32x32 -o new"
SHORT = "patterns bernoulli -k 4 --size 8x8 -o new"


@contextmanager
def stopped_at_work(folder: Path, command: str) -> Iterator[Command]:
    """A command that was stopped with work behind it and work ahead of it.

    On a busy machine it may be over before it is stopped; it is then started again.
    """
    before = set(_names(folder))

    def begun() -> bool:
        """Whether it has finished tiles, or anything new lies there but its lock.

        Between the lock and the first file a Ctrl-C may leave the lock, which binds nobody: the
        kernel has let go of it, and the next run takes it over.
        """
        if command == SLOW:
            return len(_names(folder / PARTIAL)) > 5
        return any(not name.endswith(".lock") for name in set(_names(folder)) - before)

    for _ in range(5):
        running = Command(command, folder)
        try:
            end = time.monotonic() + HANG
            while not begun() and not running.ended() and time.monotonic() < end:
                time.sleep(0.001)
            if not running.ended():
                os.kill(running.pid, signal.SIGSTOP)
                time.sleep(0.01)
                if begun() and not running.ended():
                    yield running
                    return
        finally:
            running.kill()
        for name in set(_names(folder)) - before:
            remove(name)(folder)
    raise TimeoutError("it was never stopped at work")


def _names(place: Path) -> list[str]:
    try:
        return os.listdir(place)
    except OSError:
        return []


def _second_beside(second: str) -> Scenario:
    """A run stopped at work, a second one into the same output, then the first to its end."""

    def scenario(folder: Path) -> Ran:
        with stopped_at_work(folder, SLOW) as first:
            ran = run(second, folder)
            os.kill(first.pid, signal.SIGCONT)
            ended = first.wait()
            return ran if ended.code == 0 else Ran(1, "", f"the first run: {ended}")

    return scenario


def _struck(command: str, sign: int) -> Scenario:
    """A run that gets a signal at work; the result is what it did."""

    def scenario(folder: Path) -> Ran:
        with stopped_at_work(folder, command) as first:
            os.kill(first.pid, sign)
            os.kill(first.pid, signal.SIGCONT)
            return first.wait()

    return scenario


def _then(command: str, again: str, sign: int = signal.SIGKILL) -> Scenario:
    """A run that gets a signal at work, then the right command."""

    def scenario(folder: Path) -> Ran:
        _struck(command, sign)(folder)
        return run(again, folder)

    return scenario


def _at_once(folder: Path) -> Ran:
    """Two at the same moment: one wins, the other is refused, and what lies there is whole."""
    started = [Command(line, folder) for line in (SLOW, OTHER)]
    ends = [command.wait() for command in started]
    codes = sorted(str(ran.code) for ran in ends)
    # Where one was over before the other began, the second finds an output: refused as well.
    refused = next((ran.err for ran in ends if ran.code == 2), "")
    return Ran(2 if codes == ["0", "2"] else 0, f"exit codes {codes}", refused)


def _either(folder: Path, ran: Ran) -> str | None:
    mine = SAME(folder, ran)
    return mine and same_matrix("new.zarr", "lit.zarr")(folder, ran)


def _beside(name: str, line: str, says: str = "new.zarr") -> Case:
    return Case(name, line, says, scenario=_second_beside(line), leaves=MADE, check=SAME)


CASES = [
    _beside("two of one capture", SLOW, "new.zarr: is being written by another process"),
    _beside("two of two captures", OTHER),
    _beside("a second with --overwrite", f"{OTHER} --overwrite"),
    _beside("a second by another path", OTHER.replace("new.zarr", "../work/new.zarr")),
    Case(
        "two estimates at the same moment",
        SLOW,
        (),
        lambda folder: run(f"estimate lit {SLOWLY} -o lit.zarr", folder),
        scenario=_at_once,
        leaves=MADE,
        check=_either,
    ),
    *(
        Case(
            f"an estimate goes on after signal {sign:d}",
            code=0,
            scenario=_then(SLOW, SLOW, sign),
            makes=("new.zarr",),
            check=SAME,
        )
        for sign in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
    ),
    Case(
        "an estimate interrupted at work",
        SLOW,
        "kept",
        code=130,
        scenario=_struck(SLOW, signal.SIGINT),
        makes=MADE,
        then=SLOW,
    ),
    *(
        Case(
            f"patterns after signal {sign:d} are swept by the next run",
            code=0,
            scenario=_then(LONG, SHORT, sign),
            makes=("new",),
            check=holds("new/pattern_0003.png"),
        )
        for sign in (signal.SIGKILL, signal.SIGTERM)
    ),
    *(
        Case(
            f"patterns stopped at work by signal {sign:d} leave nothing",
            code=(130, -2),
            scenario=_struck(LONG, sign),
            makes=(),
        )
        for sign in (signal.SIGINT, signal.SIGTERM)
    ),
    Case(
        "a replacement interrupted at work leaves the old",
        code=0,
        prepare=copy("patterns", "new"),
        scenario=_then(
            f"{LONG} --overwrite", "simulate T.npz --patterns new -o shown", signal.SIGINT
        ),
        makes=("shown",),
    ),
    *(
        Case(f"somebody's own {name}", f"{PLAIN} -o new.zarr", (), text(name, "mine"), code=(0, 2))
        for name in ("new.zarr.lock", ".new.zarr.lock")
    ),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_together(case: Case, work: Path) -> None:
    bear(case, work)
