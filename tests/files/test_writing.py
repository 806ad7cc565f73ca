"""Outputs are whole or absent, the old one stays until then, and one process writes at a time."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from lightmatrix.cli import main
from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.files.kinds import FileKind, OutputKind
from lightmatrix.files.writing import atomic_files, atomic_folder, check_output, claimed, locked
from tests.helpers.limits import largest_file
from tests.helpers.systems import FLOCKS, FORKS, LIMITS, PIPES, SIGNALS

if sys.platform != "win32":
    import fcntl

from tests.helpers.outputs import CAPTURE, interrupted, snapshot, write

# Forks a child for each step that it could be killed at; imports little, so that this is fast.
KILLED = """
import os, signal, sys
from pathlib import Path
from lightmatrix.files import writing as outputs
from lightmatrix.files.kinds import FileKind, FolderKind

folder, mode = Path(sys.argv[1]), sys.argv[2]
out = folder / "out"
folders, texts = FolderKind("capture"), FileKind("text", (), "")

def replace(text):
    if mode == "file":
        with outputs.atomic_file(out, texts, overwrite=True) as part:
            part.write_text(text)
        return
    with outputs.atomic_folder(out, folders, overwrite=True) as part:
        (part / "images").mkdir()
        for name in ("capture.json", "images/0.png"):
            (part / name).write_text(text)

def content():
    if mode == "folder":
        # The next run of this output puts it back.
        with outputs.claimed(out, folders, overwrite=True):
            pass
    files = [out] if mode == "file" else [out / "capture.json", out / "images" / "0.png"]
    texts = {file.read_text() for file in files}
    assert len(texts) == 1, texts
    return texts.pop()

replace("0")
step, status = 0, 1
while status:
    step += 1
    child = os.fork()
    if child == 0:
        seen = 0
        def count(event, _):
            global seen
            seen += event.startswith(("os.", "open", "shutil", "ctypes.dl", "fcntl"))
            if seen == step:
                os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(count)
        replace(str(step))
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert status == 0 or os.WTERMSIG(status) == signal.SIGKILL, status
    text = content()
    assert text in (str(step), str(step - 1)), (step, text)
    # The next step begins with what this one left, but for the content.
    replace(str(step))
    assert os.listdir(folder) == ["out"], (step, os.listdir(folder))
print(step)
"""


@FORKS
@pytest.mark.parametrize("mode", ["file", "folder"])
def test_killed_at_any_step_the_old_output_or_the_new_one_is_there(
    tmp_path: Path, mode: str
) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path), mode]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) > 8
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("old", [False, True])
def test_a_run_stopped_between_its_files_is_not_in_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: bool
) -> None:
    names, replace = ("a.ply", "b.tif", "c.png"), os.replace
    kinds: dict[str | Path, OutputKind] = {
        tmp_path / name: FileKind("file", (), (b"",)) for name in names
    }

    def put(text: str, overwrite: bool) -> None:
        with atomic_files(kinds, overwrite=overwrite) as parts:
            for part in parts:
                part.write_text(text)

    def stopping(source: Path, target: Path) -> None:
        if target.name == "b.tif":
            os.kill(os.getpid(), signal.SIGINT)
        replace(source, target)

    if old:
        put("old", overwrite=False)
    monkeypatch.setattr("lightmatrix.files.writing.os.replace", stopping)
    # Runs in the background ignore Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt):
        put("new", overwrite=True)
    signal.signal(signal.SIGINT, before)
    assert [each.name for each in sorted(tmp_path.iterdir())] == [*names] * old
    assert {each.read_text() for each in tmp_path.iterdir()} <= {"old"}
    monkeypatch.setattr("lightmatrix.files.writing.os.replace", replace)
    put("newer", overwrite=old)
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == dict.fromkeys(
        names, "newer"
    )
    with pytest.raises(OutputError, match="exists already"):
        put("again", overwrite=False)


def test_what_is_in_the_way_of_the_temporary_folder_stays(tmp_path: Path) -> None:
    (tmp_path / ".out.part").mkdir()
    (tmp_path / ".out.part" / "mine").touch()
    with pytest.raises(OutputError, match=r"\.out\.part: is in the way"):
        write(tmp_path / "out")
    assert (tmp_path / ".out.part" / "mine").exists()
    assert os.listdir(tmp_path) == [".out.part"]


def test_nothing_is_made_before_there_is_something_to_write(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b" / "out"
    check_output(target, CAPTURE)
    assert not os.listdir(tmp_path)
    with claimed(target, CAPTURE):
        assert target.parent.is_dir()
    with pytest.raises(RuntimeError, match="stop"):
        interrupted(target)
    assert not os.listdir(tmp_path)
    write(target)
    assert os.listdir(target.parent) == ["out"]


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Root may write anywhere, so the system's answer is replaced.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="no permission to write"):
        check_output(tmp_path / "a" / "out", CAPTURE)


def test_an_old_folder_comes_back_if_a_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = os.rename

    def stopped(source: Path, target: Path) -> None:
        if source.name == "new":
            raise KeyboardInterrupt
        rename(source, target)

    write(tmp_path / "out")
    before = snapshot(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", stopped)
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / "out", "new", overwrite=True)
    assert snapshot(tmp_path) == before


def test_a_claim_within_a_claim_spares_the_outer_ones_folder(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out", CAPTURE) as part:
        (part / "capture.json").write_text("outer")
        with pytest.raises(OutputError, match="cannot be written"):
            write(tmp_path / "out")
        assert (part / "capture.json").read_text() == "outer"
    assert (tmp_path / "out" / "capture.json").read_text() == "outer"


def test_a_folder_that_cannot_be_removed_is_removed_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", lambda *_, **__: None)
        with (
            pytest.raises(OutputError, match="No space left"),
            atomic_folder(tmp_path / "out", CAPTURE),
        ):
            raise OSError(errno.ENOSPC, "No space left on device")
    assert os.listdir(tmp_path) == [".out.part"]
    write(tmp_path / "out")
    assert os.listdir(tmp_path) == ["out"]


@LIMITS
@pytest.mark.parametrize("size", [0, 20, 100, 400, 2000])
def test_a_full_disk_spares_the_old_folder(tmp_path: Path, size: int) -> None:
    write(tmp_path / "out")
    before = snapshot(tmp_path)
    with largest_file(size), pytest.raises(OutputError, match="cannot be written"):
        write(tmp_path / "out", "new" * 1000, overwrite=True)
    assert snapshot(tmp_path) == before


@pytest.mark.skipif(sys.platform != "linux", reason="pretends with Linux's /proc")
def test_outputs_are_written_and_replaced_as_windows_lets_them(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.helpers.windows_like", str(tmp_path)],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-4000:]


# ---- locks

HOLDER = """
import sys
from lightmatrix.files.kinds import FolderKind
from lightmatrix.files.writing import claimed
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
    for name in ("out", "./out"):
        line = f"patterns bernoulli -k 2 --size 4x4 -o {tmp_path}/{name}"
        assert main(line.split()) == 2
        assert "out: is being written by another process" in capsys.readouterr().err
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
    assert "is being written by another" in str(errors[0])
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


@FORKS
def test_a_forked_child_does_not_hold_or_remove_the_lock_of_its_parent(tmp_path: Path) -> None:
    with locked(tmp_path / "out"):
        child = os.fork()
        if child == 0:
            try:
                write(tmp_path / "out")
            except OutputError:
                os._exit(7)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        assert (tmp_path / ".out.lock").exists()


# ---- commands


def test_what_another_thread_still_writes_is_removed_too(tmp_path: Path) -> None:
    def write(place: Path) -> None:
        time.sleep(0.03)
        place.mkdir(parents=True, exist_ok=True)
        (place / "zarr.json").touch()

    with suppress(KeyboardInterrupt), atomic_folder(tmp_path / "new", CAPTURE) as part:
        thread = threading.Thread(target=write, args=(part / "data",))
        thread.start()
        raise KeyboardInterrupt
    thread.join()
    assert not list(tmp_path.iterdir())
