"""Ctrl-C at once, and standard output that is closed, full, broken or ASCII."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from ..case import Case, Command, Ran, Scenario, SkipError
from ..put import both, copy, json_at

INFO = "info scene.zarr"
# The installed command, begun as the system begins it.
_SCRIPT = Path(sys.executable).with_name("lightmatrix")
_INTERRUPTED = """
import os, runpy, signal, sys, threading
signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Timer(float(sys.argv[1]), os.kill, (os.getpid(), signal.SIGINT)).start()
sys.argv[:] = sys.argv[2:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def _script() -> str:
    if not _SCRIPT.exists():
        raise SkipError("the command is not installed")
    return str(_SCRIPT)


def by_shell(line: str, **environment: str) -> Scenario:
    """A command as a shell runs it, with its redirections; `lm` stands for the program."""

    def scenario(folder: Path, run: Command) -> Ran:
        # `set -o pipefail` is not POSIX's; the program's own code is asked for where needed.
        started = time.perf_counter()
        program = f'lm() {{ "{sys.executable}" "{_script()}" "$@"; }}; '
        try:
            done = subprocess.run(
                ["bash", "-c", program + line],
                cwd=folder,
                env={**os.environ, **environment},
                capture_output=True,
                timeout=60,
            )
        except subprocess.TimeoutExpired:
            return Ran(None)
        out, err = (s.decode("utf-8", "replace") for s in (done.stdout, done.stderr))
        return Ran(done.returncode, out, err, time.perf_counter() - started)

    return scenario


def _interrupt(after: float, command: str) -> Scenario:
    def scenario(folder: Path, run: Command) -> Ran:
        words = [sys.executable, "-c", _INTERRUPTED, str(after), _script(), *command.split()]
        try:
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=60)
        except subprocess.TimeoutExpired:
            return Ran(None)
        return Ran(done.returncode, done.stdout, done.stderr)

    return scenario


def _streams() -> list[Case]:
    cases = []
    quiet = (0, 141, 128 + 13)
    for words, command in {
        "help": "--help",
        "info": INFO,
        "info as JSON": f"{INFO} --json",
        "patterns": "patterns bernoulli -k 2 --size 8x8 -o new --json",
    }.items():
        made = ("new",)
        cases += [
            Case(
                f"{words} to a full disk",
                command,
                "",
                code=2,
                scenario=by_shell(f"lm {command} >/dev/full"),
                makes=made,
                leaves=made,
            ),
            Case(
                f"{words} to a reader that is gone",
                command,
                "",
                code=quiet,
                scenario=by_shell(
                    f"(sleep 0.1; lm {command}; echo $? >../../tmp/code) | true; "
                    "exit $(cat ../../tmp/code; rm ../../tmp/code)"
                ),
                makes=made,
            ),
            Case(
                f"{words} with standard output closed",
                command,
                "",
                code=(0, 2),
                scenario=by_shell(f"lm {command} >&-"),
                makes=made,
                leaves=made,
            ),
        ]
    cases += [
        Case(
            "info with standard error closed",
            INFO,
            "",
            code=0,
            scenario=by_shell(f"lm {INFO} 2>&-"),
        ),
        Case(
            "a refusal with standard error closed",
            INFO,
            "",
            code=1,
            scenario=by_shell("lm info gone.zarr 2>&-; test $? = 2 && exit 1"),
        ),
        Case(
            "a refusal to a full standard error",
            INFO,
            "",
            code=1,
            scenario=by_shell("lm info gone.zarr 2>/dev/full; test $? = 2 && exit 1"),
        ),
        Case("info with standard input closed", INFO, code=0, scenario=by_shell(f"lm {INFO} <&-")),
        Case(
            "info of a name that is no text",
            "info",
            "no such file",
            scenario=by_shell("lm info $(printf 'a\\xffb')"),
        ),
        Case(
            "info with all streams closed",
            INFO,
            "",
            code=(0, 2),
            scenario=by_shell(f"lm {INFO} <&- >&- 2>&-"),
        ),
        Case(
            "scenes in ASCII",
            "scenes",
            "",
            code=0,
            scenario=by_shell("lm scenes", PYTHONIOENCODING="ascii"),
        ),
        Case(
            "info of other letters in ASCII",
            INFO,
            "",
            _umlauts,
            code=0,
            scenario=by_shell("lm info größe.zarr", PYTHONIOENCODING="ascii"),
        ),
        Case(
            "info of other letters in the C locale",
            INFO,
            "",
            _umlauts,
            code=0,
            scenario=by_shell(
                "lm info größe.zarr", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"
            ),
        ),
        Case(
            "JSON of other letters in ASCII",
            INFO,
            "",
            _umlauts,
            code=0,
            scenario=by_shell("lm info größe.zarr --json", PYTHONIOENCODING="ascii"),
        ),
        Case(
            "an error of other letters in ASCII",
            "info größe2.zarr",
            "",
            scenario=by_shell("lm info größe2.zarr", PYTHONIOENCODING="ascii"),
        ),
        Case(
            "help in ASCII",
            "--help",
            "",
            code=0,
            scenario=by_shell("lm estimate --help", PYTHONIOENCODING="ascii"),
        ),
        Case(
            "a terminal of 1 column", INFO, "", code=0, scenario=by_shell(f"lm {INFO}", COLUMNS="1")
        ),
        Case(
            "a terminal of 0 columns",
            INFO,
            "",
            code=0,
            scenario=by_shell(f"lm {INFO}", COLUMNS="0"),
        ),
        Case(
            "a terminal of nonsense",
            INFO,
            "",
            code=0,
            scenario=by_shell(f"lm {INFO}", COLUMNS="wide", TERM="unknown", FORCE_COLOR="1"),
        ),
        Case(
            "a home that does not exist",
            INFO,
            "",
            code=0,
            scenario=by_shell(f"lm {INFO}", HOME="/nowhere/at/all", MPLCONFIGDIR="/nowhere/at/all"),
        ),
        Case(
            "a temporary folder that does not exist",
            "export scene.zarr new.npz",
            "",
            code=(0, 2),
            scenario=by_shell("lm export scene.zarr new.npz", TMPDIR="/nowhere/at/all"),
        ),
        Case(
            "a current folder that is gone",
            INFO,
            "",
            code=(0, 2),
            scenario=by_shell("mkdir away && cd away && rmdir ../away && lm info scene.zarr"),
        ),
    ]
    return cases


def _umlauts(folder: Path) -> None:
    both(
        copy("scene.zarr", "größe.zarr"),
        json_at(
            "größe.zarr/zarr.json",
            "attributes",
            "provenance",
            value={"scene": "日本", "estimator": "é"},
        ),
    )(folder)


def _interrupts() -> list[Case]:
    command = "patterns bernoulli -k 20000 --size 64x64 -o new"
    # 0.1 s is in the midst of the first imports, 1 s at work. Earlier still Python itself is
    # starting, and answers in its own way.
    return [
        Case(
            f"Ctrl-C after {after} s",
            command,
            "",
            code=(130, -2),
            scenario=_interrupt(after, command),
            makes=(),
        )
        for after in (0.1, 0.3, 0.6, 1.0, 3.0)
    ]


# What its cases need of the work folder.
NEEDS: tuple[str, ...] = ("scene.zarr",)

CASES = [*_streams(), *_interrupts()]
