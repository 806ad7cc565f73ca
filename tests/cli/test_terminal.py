"""What commands print and how they end: odd names, narrow terminals, Ctrl-C, lack of memory."""

from __future__ import annotations

import builtins
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix import cli
from lightmatrix.cli import main
from lightmatrix.judgement.evaluate import Errors
from lightmatrix.reprs import labelled
from lightmatrix.solvers import solve
from tests.helpers.systems import SHELL, SIGNALS

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(autouse=True)
def _a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "x[red]:smile:[" / "y].zarr"
    matrix = lm.truth("metal").transport()
    lm.save(
        path,
        lm.LightTransport(
            matrix.sparse[:6], matrix.background[:6], (2, 3), (64, 64),
            provenance={"scene": "[/bold] :heart: [blink]", "versions": {"[x": "[/y]"}},
        ),
    )  # fmt: skip
    return path


def _save_capture() -> None:
    """A capture of 8 photographs in the folder `capture`."""
    truth = lm.ProceduralScene((16, 16), (16, 16)).truth()
    lm.simulate(truth, lm.BernoulliPatterns((16, 16), 8)).save("capture")


def test_names_are_shown_as_they_are(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(store), "--verbose"]) == 0
    shown = capsys.readouterr().out
    assert str(store) in shown
    assert "[/bold] :heart: [blink]" in shown
    assert "made with [x [/y]" in shown
    lm.write_image("p.png", np.full((64, 64), 255, np.uint8))
    assert main(["relight", str(store), "p.png", "-o", "x[/y]:x:.png"]) == 0
    assert "x[/y]:x:.png" in capsys.readouterr().out
    assert main(["info", "nothing [/here] :x:"]) == 2
    assert "nothing [/here] :x:" in capsys.readouterr().err


def test_a_terminal_of_80_columns_has_room_for_the_values(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _save_capture()
    line = "estimate capture -o s.zarr --no-check --no-coherent --iterations 1"
    assert main(line.split()) == 0
    shown = capsys.readouterr().out
    verdict, relighting, correspondence, _, *rows = shown.splitlines()
    assert verdict.startswith("T: Not tested. ")
    assert relighting.startswith("Relighting: ")
    assert correspondence.startswith("Correspondence: ")
    assert 8 <= len(rows) <= 12
    assert main(["info", "s.zarr"]) == 0
    assert shown.startswith(capsys.readouterr().out)
    assert main(["info", "s.zarr", "--verbose"]) == 0
    rows = [row for row in capsys.readouterr().out.splitlines() if row.startswith("  ")]
    assert len(rows) > 13
    # A wrapped value would go on below a blank label.
    assert all(row[2] != " " and len(row) <= 80 for row in rows)
    labels = labelled(dict.fromkeys(Errors.__dataclass_fields__, 0.5))
    assert max(map(len, labels)) <= 26


def test_a_name_cannot_move_the_cursor(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "a\x1b[2Jb\x07"]) == 2
    assert "\x1b" not in capsys.readouterr().err


@SIGNALS
def test_ctrl_c_while_modules_are_loaded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = builtins.__import__

    def interrupted(name: str, *rest: Any, **more: Any) -> Any:
        if name == "lightmatrix.cli.app":
            raise KeyboardInterrupt
        return whole(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", interrupted)
    assert main(["--help"]) == 130
    assert capsys.readouterr().err == "stopped\n"


def test_ctrl_c_that_a_library_turned_into_its_own_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(path: Path) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise ImportError("numpy failed to load") from stop

    monkeypatch.setattr(lm, "open", load)
    assert main(["info", "x.zarr"]) == 130
    assert capsys.readouterr().err == "stopped\n"


@pytest.mark.parametrize("finished", [0, 1])
def test_a_stop_promises_finished_tiles_only_if_there_are_some(
    finished: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _save_capture()
    solved = [0]

    def stopped(*arguments: Any, **more: Any) -> Any:
        if solved[0] == finished:
            raise KeyboardInterrupt
        solved[0] += 1
        return solve(*arguments, **more)

    monkeypatch.setattr("lightmatrix.estimators.plain.solve", stopped)
    line = "estimate capture -o s.zarr --solver romp --iterations 1 --tile-rows 128"
    assert main(line.split()) == 130
    message = capsys.readouterr().err
    assert ("finished tiles are kept" in message) == bool(finished)
    assert Path("s.zarr.partial").exists() == bool(finished)


def test_ctrl_c_after_the_output_says_that_it_is_finished(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(transport: Any) -> None:
        # Some libraries turn the stop into an exception of their own.
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise RuntimeError("cancelled") from stop

    _save_capture()
    monkeypatch.setattr(lm, "verdicts", stopped)
    line = "estimate capture -o s.zarr --solver romp --iterations 1"
    for again in ("", " --overwrite"):
        assert main((line + again).split()) == 130
        assert capsys.readouterr().err.endswith("stopped\n")
        assert lm.open("s.zarr").camera_shape == (16, 16)


def test_lack_of_memory_after_the_output_leaves_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(*_: Any) -> None:
        raise MemoryError

    _save_capture()
    line = "estimate capture -o s.zarr --solver romp --iterations 1 --json"
    monkeypatch.setattr("lightmatrix.transport.store.StoredTransport.load", failing)
    assert main(line.split()) == 3
    assert "error: not enough memory\n" in capsys.readouterr().err
    assert main(line.split()) == 2
    assert "s.zarr: exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (MemoryError(), 3, "error: not enough memory"),
        (RuntimeError("can't start new thread"), 3, "error: not enough memory"),
        (PermissionError(13, "Permission denied", "x.zarr"), 2, "error: x.zarr: Permission"),
        (ValueError("a [bug]\nof ours"), 70, "internal error: ValueError: a [bug] of ours"),
        (StopIteration(), 70, "internal error: StopIteration"),
        (EOFError("end"), 70, "internal error: EOFError: end"),
        (SystemError("odd"), 70, "internal error"),
    ],
)
def test_every_end_has_one_message_and_a_code(
    error: BaseException, code: int, message: str,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def fail(path: Path) -> None:
        raise error

    monkeypatch.setattr(lm, "open", fail)
    assert main(["info", "x.zarr"]) == code
    shown = capsys.readouterr().err
    assert shown.startswith(message)
    assert "Traceback" not in shown
    monkeypatch.setenv("LIGHTMATRIX_DEBUG", "1")
    assert main(["info", "x.zarr"]) == code
    assert ("Traceback" in capsys.readouterr().err) == (code == 70)


def test_help_lists_the_exit_codes_and_the_stages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "0 done, 1 `check` found a fault, 2 bad input or output, 3 out of memory, 70 a bug" in shown
    )
    assert shown.index("Prepare:") < shown.index("Measure and use:") < shown.index("Simulate:")
    assert cli.console.__doc__


@SIGNALS
def test_ctrl_c_ends_the_loading_of_libraries_whatever_they_catch(tmp_path: Path) -> None:
    # Loaded in place of a library, it would swallow a KeyboardInterrupt.
    (tmp_path / "typer.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "except BaseException: pass\n"
        "print('went on')\n"
    )
    script = (
        "import signal\n"
        # Background jobs of a shell ignore interrupts, and this child would inherit that.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from lightmatrix.cli import console\n"
        "console()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path
    )
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


@SHELL
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("lightmatrix est", ["estimate"]),
        ("lightmatrix estimate --solver ro", ["romp"]),
        ("lightmatrix check --resp", ["--response"]),
    ],
)
def test_a_shell_completes_commands_and_options(
    words: str, expected: list[str], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("_LIGHTMATRIX_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    assert main([]) == 0
    assert capsys.readouterr().out.split() == expected


@SHELL
def test_completion_installs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    # shellingham looks for a shell among the parents of the process; tests may run without one.
    monkeypatch.setattr("shellingham.detect_shell", lambda *_: ("bash", "/bin/bash"))
    assert main(["--install-completion", "bash"]) == 0
    assert "installed" in capfd.readouterr().out
    written = (tmp_path / ".bashrc").read_text()
    assert "lightmatrix" in written


def test_ctrl_c_that_a_finalizer_swallows_comes_again() -> None:
    code = (
        "import os, signal, sys, time\n"
        "from lightmatrix import cli\n"
        "class Finalized:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(0.2)\n"
        "def work():\n"
        "    Finalized()\n"
        "    time.sleep(110)\n"
        "cli.main = work\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "cli.console()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
