"""Ctrl-C at once, and standard output that is closed, full, broken or ASCII."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .case import Case, Scenario, bear
from .put import both, copy, json_at
from .run import HANG, Ran, SkipError

NEEDS = ("scene.zarr",)
INFO = "info scene.zarr"
# The installed command, begun as the system begins it.
_SCRIPT = Path(sys.executable).with_name("lightmatrix")
# Before `console` begins and sets the collector's threshold, Python answers in its own way.
_INTERRUPTED = """
import gc, os, runpy, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
after, threshold = float(sys.argv[1]), gc.get_threshold()
def interrupt():
    while gc.get_threshold() == threshold:
        time.sleep(0.001)
    time.sleep(after)
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=interrupt, daemon=True).start()
sys.argv[:] = sys.argv[2:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def _run(words: list[str], folder: Path, **environment: str) -> Ran:
    if not _SCRIPT.exists():
        raise SkipError("the command is not installed")
    try:
        done = subprocess.run(
            words, cwd=folder, env={**os.environ, **environment}, capture_output=True, timeout=HANG
        )
    except subprocess.TimeoutExpired:
        return Ran(None)
    return Ran(done.returncode, *(s.decode("utf-8", "replace") for s in (done.stdout, done.stderr)))


def by_shell(line: str, **environment: str) -> Scenario:
    """A command as a shell runs it, with its redirections; `lm` stands for the program."""
    program = f'lm() {{ "{sys.executable}" "{_SCRIPT}" "$@"; }}; '
    return lambda folder: _run(["bash", "-c", program + line], folder, **environment)


def _interrupted(after: float, command: str) -> Scenario:
    words = [sys.executable, "-c", _INTERRUPTED, str(after), str(_SCRIPT), *command.split()]
    return lambda folder: _run(words, folder)


def _outputs() -> list[Case]:
    command, new = "patterns bernoulli -k 2 --size 8x8 -o new --json", ("new",)
    gone = (
        f"(sleep 0.1; lm {command}; echo $? >../../tmp/code) | true; "
        "exit $(cat ../../tmp/code; rm ../../tmp/code)"
    )
    return [
        Case(f"patterns {end}", scenario=by_shell(line), code=code, makes=new, leaves=new)
        for end, line, code in (
            ("to a full disk", f"lm {command} >/dev/full", (2,)),
            ("to a reader that is gone", gone, (0, 141)),
            ("with standard output closed", f"lm {command} >&-", (0, 2)),
        )
    ]


def _umlauts(folder: Path) -> None:
    value = {"scene": "日本", "estimator": "é"}
    path = ("größe.zarr/zarr.json", "attributes", "provenance")
    both(copy("scene.zarr", "größe.zarr"), json_at(*path, value=value))(folder)


def _surroundings() -> list[Case]:
    ascii_only = {"PYTHONIOENCODING": "ascii"}
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    nowhere = {"HOME": "/nowhere/at/all", "MPLCONFIGDIR": "/nowhere/at/all"}
    gone = "mkdir away && cd away && rmdir ../away && lm info scene.zarr"
    # What -> line for a shell, variables, exit codes.
    lines: dict[str, tuple[str, dict[str, str], int | tuple[int, ...]]] = {
        "all streams closed": (f"lm {INFO} <&- >&- 2>&-", {}, (0, 2)),
        "a refusal with standard error closed": ("! lm info no 2>&- || exit 1", {}, 0),
        "a refusal to a full standard error": ("! lm info no 2>/dev/full || exit 1", {}, 0),
        "help in ASCII": ("lm estimate --help", ascii_only, 0),
        "other letters in ASCII": ("lm info größe.zarr", ascii_only, 0),
        "other letters in the C locale": ("lm info größe.zarr", locale, 0),
        "an error of other letters in ASCII": ("lm info größe2.zarr", ascii_only, 2),
        "a name that is no text": ("lm info $(printf 'a\\xffb')", {}, 2),
        "a terminal of nonsense": (f"lm {INFO}", {"COLUMNS": "wide", "TERM": "unknown"}, 0),
        "a home that does not exist": (f"lm {INFO}", nowhere, 0),
        "a temporary folder that does not exist": (
            "lm export scene.zarr new.npz",
            {"TMPDIR": "/nowhere/at/all"},
            (0, 2),
        ),
        "a current folder that is gone": (gone, {}, (0, 2)),
    }
    return [
        Case(
            words,
            prepare=_umlauts,
            code=code,
            makes=("new.npz",),
            scenario=by_shell(line, **environment),
        )
        for words, (line, environment, code) in lines.items()
    ]


def _interrupts() -> list[Case]:
    command = "patterns bernoulli -k 20000 --size 64x64 -o new"
    # 0.1 s is in the midst of the first imports, 1 s at work.
    return [
        Case(f"Ctrl-C after {s} s", code=(130, -2), scenario=_interrupted(s, command), makes=())
        for s in (0.1, 1.0)
    ]


CASES = [*_outputs(), *_surroundings(), *_interrupts()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_streams(case: Case, work: Path) -> None:
    bear(case, work)
