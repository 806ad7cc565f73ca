"""One thread of one process writes an output at a time, and others learn who."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from lightmatrix.cli import main
from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.outputs.locks import check_unlocked, locked
from lightmatrix.outputs.writing import claimed
from tests.helpers.limits import largest_file
from tests.helpers.systems import FLOCKS, FORKS, LIMITS, PIPES, SIGNALS

if sys.platform != "win32":
    import fcntl
from tests.helpers.outputs import CAPTURE, snapshot, write

HOLDER = """
import sys
from lightmatrix.outputs.locks import check_unlocked, locked
from lightmatrix.outputs.markers import FolderKind
from lightmatrix.outputs.writing import claimed
with claimed(sys.argv[1], FolderKind("capture")):
    print("ready", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of `out`."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process
        with suppress(ProcessLookupError):
            process.terminate()


def test_two_processes_do_not_write_one_output(
    tmp_path: Path, holder: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "out" / ".." / "out")
    assert main(["patterns", "bernoulli", "-k", "2", "--size", "4x4", "-o", f"{tmp_path}/out"]) == 2
    message = capsys.readouterr().err
    assert f"is being written by process {holder.pid} on" in message
    assert "-c" in message
    assert not (tmp_path / "out").exists()
    holder.communicate("\n")
    assert sorted(os.listdir(tmp_path)) == ["link"]
    write(tmp_path / "out")


@SIGNALS
def test_the_lock_of_a_dead_process_is_taken_over(
    tmp_path: Path, holder: subprocess.Popen[str]
) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert os.listdir(tmp_path) == [".out.lock"]
    write(tmp_path / "out")
    assert os.listdir(tmp_path) == ["out"]


def test_a_thread_holds_its_lock_once_and_keeps_others_out(tmp_path: Path) -> None:
    errors: list[BaseException] = []

    def other() -> None:
        try:
            write(tmp_path / "out")
        except OutputError as error:
            errors.append(error)

    with claimed(tmp_path / "out", CAPTURE), claimed(tmp_path / "out", CAPTURE):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        write(tmp_path / "out")
    assert "is being written by" in str(errors[0])
    assert os.listdir(tmp_path) == ["out"]


@PIPES
def test_a_file_that_is_no_lock_is_neither_used_nor_removed(tmp_path: Path) -> None:
    (tmp_path / ".a.lock").write_text("mine")
    (tmp_path / ".b.lock").symlink_to(".a.lock")
    os.mkfifo(tmp_path / ".c.lock")
    before = snapshot(tmp_path)
    for name in "abc":
        with pytest.raises(OutputError):
            write(tmp_path / name)
    assert snapshot(tmp_path) == before


@FLOCKS
def test_file_systems_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", unknown)
    with pytest.warns(LightMatrixWarning, match="has no locks"):
        write(tmp_path / "out")
    assert os.listdir(tmp_path) == ["out"]


def test_a_check_names_who_writes_and_makes_nothing(
    tmp_path: Path, holder: subprocess.Popen[str]
) -> None:
    with pytest.raises(OutputError, match=f"is being written by process {holder.pid} on"):
        check_unlocked(tmp_path / "out")
    check_unlocked(tmp_path / "other")
    assert os.listdir(tmp_path) == [".out.lock"]


def test_the_owner_of_a_lock_may_check_it(tmp_path: Path) -> None:
    with locked(tmp_path / "out") as is_new, locked(tmp_path / "out") as again:
        assert is_new
        assert not again
        check_unlocked(tmp_path / "out")
        owner = json.loads((tmp_path / ".out.lock").read_text())
        assert (owner["format"], owner["pid"]) == ("lightmatrix-lock", os.getpid())
    assert not os.listdir(tmp_path)


@LIMITS
def test_a_lock_without_room_for_the_name_of_its_owner(tmp_path: Path) -> None:
    with largest_file(0), locked(tmp_path / "out") as is_new:
        assert is_new
        assert (tmp_path / ".out.lock").stat().st_size == 0
        errors: list[BaseException] = []

        def other() -> None:
            try:
                check_unlocked(tmp_path / "out")
            except OutputError as error:
                errors.append(error)

        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert "is being written by another process" in str(errors[0])
    assert not os.listdir(tmp_path)


@FORKS
def test_a_forked_child_does_not_hold_or_remove_the_lock_of_its_parent(tmp_path: Path) -> None:
    with locked(tmp_path / "out"):
        child = os.fork()
        if child == 0:
            try:
                check_unlocked(tmp_path / "out")
            except OutputError:
                os._exit(7)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        assert (tmp_path / ".out.lock").exists()
