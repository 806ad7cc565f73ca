"""Outputs replace only what lightmatrix wrote, are whole or absent, and are locked meanwhile."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.cli import main
from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.experiments import run
from lightmatrix.experiments.harness import Experiment, Measured
from lightmatrix.files.images import read_image, write_image
from lightmatrix.outputs import targets
from lightmatrix.outputs import writing as outputs
from lightmatrix.outputs.kinds import IMAGE, MAT, NPZ
from lightmatrix.outputs.markers import FileKind, FolderKind, OutputKind
from lightmatrix.outputs.running import RunningResults
from lightmatrix.outputs.writing import atomic_file, atomic_folder, check_output, claimed
from tests.helpers.limits import largest_file
from tests.helpers.systems import FLOCKS, FORKS, LIMITS, PIPES, SIGNALS

if sys.platform != "win32":
    import fcntl

CAPTURE = FolderKind("capture")
TEXT = FileKind("text", (), lambda file: file.read_text().startswith("ours"))


def write(target: Path, text: str = "old", overwrite: bool = False) -> None:
    with atomic_folder(target, CAPTURE, overwrite=overwrite) as part:
        (part / "capture.json").write_text(text)
        (part / "images").mkdir()
        (part / "images" / "0.png").write_text(text)


def interrupted(target: Path) -> None:
    with atomic_folder(target, CAPTURE, overwrite=True) as part:
        (part / "capture.json").write_text("half")
        raise RuntimeError("stop")


def snapshot(folder: Path) -> dict[str, str]:
    """Every entry below a folder with what it is."""
    found = {}
    for path in sorted(folder.rglob("*")):
        kind = stat.S_IFMT(path.lstat().st_mode)
        content = path.read_bytes().hex() if kind == stat.S_IFREG else ""
        found[str(path.relative_to(folder))] = f"{kind} {content}"
    return found


# ---- what is replaced


def test_folders_are_replaced_whole(tmp_path: Path) -> None:
    target = tmp_path / "capture"
    write(target)
    with pytest.raises(OutputError, match="exists already"):
        write(target, "new")
    with pytest.raises(RuntimeError, match="stop"):
        interrupted(target)
    assert (target / "capture.json").read_text() == "old"
    write(target, "new", overwrite=True)
    assert (target / "capture.json").read_text() == "new"
    assert os.listdir(tmp_path) == ["capture"]
    (tmp_path / "empty").mkdir()
    write(tmp_path / "empty")
    assert (tmp_path / "empty" / "images" / "0.png").exists()


PLACES = st.sampled_from(["", "images", "images/more", "new/er"])
NAMES = st.sampled_from(["photo.jpg", "0.png ", "capture.json~", ".hidden", "\udcff", "[/x]"])
CHANGES = st.sampled_from(["add", "link", "folder link", "pipe", "edit", "unmark", "nothing"])


@PIPES
@settings(max_examples=60, deadline=None)
@given(PLACES, NAMES, CHANGES)
def test_a_folder_with_anything_foreign_in_it_is_left_alone(
    place: str, name: str, change: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "capture"
        write(target)
        path = target / place / name
        if change != "nothing":
            path.parent.mkdir(parents=True, exist_ok=True)
        if change == "add":
            path.write_text("precious")
        elif change == "link":
            path.symlink_to("capture.json")
        elif change == "folder link":
            path.symlink_to(target / "images")
        elif change == "pipe":
            os.mkfifo(path)
        elif change == "edit":
            (target / "capture.json").write_text("edited by hand")
        elif change == "unmark":
            (target / ".lightmatrix").unlink()
        before = snapshot(Path(folder))
        if change == "nothing":
            write(target, "new", overwrite=True)
            assert (target / "capture.json").read_text() == "new"
            return
        with pytest.raises(OutputError, match="lightmatrix"):
            write(target, "new", overwrite=True)
        assert snapshot(Path(folder)) == before


def test_a_file_that_comes_while_the_new_folder_is_made_is_not_lost(tmp_path: Path) -> None:
    target = tmp_path / "capture"
    write(target)
    with (
        pytest.raises(OutputError, match=r"holds photo\.jpg"),
        atomic_folder(target, CAPTURE, overwrite=True),
    ):
        (target / "photo.jpg").touch()
    assert (target / "photo.jpg").exists()
    assert os.listdir(tmp_path) == ["capture"]


@pytest.mark.parametrize(
    "marker", ["", "[]", "{}", '{"format": 1}', "[" * 100_000, '{"format": "lightmatrix-capture"}']
)
def test_markers_of_others_are_none(tmp_path: Path, marker: str) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / ".lightmatrix").write_text(marker)
    (tmp_path / "a" / "capture.json").write_text('{"format": "lightmatrix-capture", "version": 1}')
    with pytest.raises(OutputError, match="not written by lightmatrix"):
        write(tmp_path / "a", overwrite=True)


def test_one_kind_of_output_does_not_replace_another(tmp_path: Path) -> None:
    write(tmp_path / "a")
    with pytest.raises(OutputError, match="holds a capture, the output is a figure"):
        check_output(tmp_path / "a", FolderKind("figure"), overwrite=True)
    with pytest.raises(OutputError, match="is a folder, the output is a file"):
        check_output(tmp_path / "a", TEXT, overwrite=True)
    (tmp_path / "b").write_text("ours")
    with pytest.raises(OutputError, match="is a file, the output is a folder"):
        check_output(tmp_path / "b", CAPTURE, overwrite=True)


@pytest.mark.parametrize(
    ("name", "kind"), [("a.npz", NPZ), ("a.mat", MAT), ("a.png", IMAGE), ("a.tif", IMAGE)]
)
def test_files_are_known_by_what_is_in_them(tmp_path: Path, name: str, kind: FileKind) -> None:
    file = tmp_path / name
    file.write_text("a letter")
    with pytest.raises(OutputError, match="not written by lightmatrix"):
        check_output(file, kind, overwrite=True)
    with file.open("wb") as stream:
        np.savez(stream, mine=np.ones(3))
    with pytest.raises(OutputError, match="not written by lightmatrix"):
        check_output(file, kind, overwrite=True)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def make_device(path: Path) -> None:
    try:
        # Of the null device's numbers, so that whatever happens to it does no harm.
        os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")


SPECIAL = {"a device": make_device, "a pipe": lambda path: os.mkfifo(path), "a socket": make_socket}


@PIPES
@pytest.mark.parametrize("kind", [CAPTURE, TEXT])
@pytest.mark.parametrize("what", SPECIAL)
def test_devices_pipes_and_sockets_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, kind: OutputKind
) -> None:
    monkeypatch.chdir(tmp_path)  # the names of sockets are short
    SPECIAL[what](Path("special"))
    Path("link").symlink_to("special")
    before = snapshot(tmp_path)
    for name in ("special", "link"):
        with pytest.raises(OutputError, match=what):
            check_output(name, kind, overwrite=True)
    with pytest.raises(OutputError, match=r"is not a folder|Not a directory"):
        check_output("special/a", kind)
    assert snapshot(tmp_path) == before


def test_places_that_are_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("here", "home", "disk", "other"):
        write(tmp_path / name / "in")
        (tmp_path / f"to {name}").symlink_to(name)
    monkeypatch.chdir(tmp_path / "here" / "in")
    for name in ("HOME", "USERPROFILE"):  # POSIX and Windows look for it here.
        monkeypatch.setenv(name, str(tmp_path / "home" / "in"))
    mounts = tmp_path / "mountinfo"
    disk = str(tmp_path / "disk" / "in" / "a b").replace(" ", "\\040")
    mounts.write_text(f"36 35 98:0 / {disk} rw - ext3 /dev/x rw\n")
    monkeypatch.setattr(targets, "_MOUNTS", mounts)
    words = {"here": "the current folder", "home": "the home folder", "disk": "disk is mounted"}
    for name, reason in words.items():
        for path in (tmp_path / name / "in", tmp_path / name, tmp_path / f"to {name}"):
            with pytest.raises(OutputError, match=reason):
                check_output(path, CAPTURE, overwrite=True)
    for text in (".", "", "..", "../..", "/", "new/..", "../in/."):
        with pytest.raises(OutputError, match="never replaced"):
            check_output(text, CAPTURE, overwrite=True)
    check_output(tmp_path / "other" / "in", CAPTURE, overwrite=True)
    assert os.path.ismount("/")


def test_links_are_followed_to_their_end(tmp_path: Path) -> None:
    write(tmp_path / "real")
    (tmp_path / "one").symlink_to("real")
    (tmp_path / "two").symlink_to("one")
    write(tmp_path / "two", "new", overwrite=True)
    assert (tmp_path / "two").is_symlink()
    assert (tmp_path / "real" / "capture.json").read_text() == "new"
    (tmp_path / "lost").symlink_to("nowhere/deep")
    (tmp_path / "round").symlink_to("round")
    for name in ("lost", "lost/a", "round"):
        with pytest.raises(OutputError, match=r"leads nowhere|symbolic links"):
            check_output(tmp_path / name, CAPTURE)
    assert not (tmp_path / "nowhere").exists()


# ---- whole or absent


# Forks a child for each step that it could be killed at; imports little, so that this is fast.
KILLED = """
import os, signal, sys
from pathlib import Path
from lightmatrix.outputs import swap, writing as outputs
from lightmatrix.outputs.markers import FileKind, FolderKind

folder, mode = Path(sys.argv[1]), sys.argv[2]
out = folder / "out"
folders, texts = FolderKind("capture"), FileKind("text", (), lambda file: True)
if mode == "moved aside":
    swap.exchange = lambda one, other: False

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
    if mode == "moved aside":
        # The next run of this output puts it back.
        with outputs.claimed(out, folders, overwrite=True):
            pass
    files = [out] if mode == "file" else [out / "capture.json", out / "images" / "0.png"]
    found = {file.read_text() for file in files}
    assert len(found) == 1, found
    return found.pop()

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
    found = content()
    assert found in (str(step), str(step - 1)), (step, found)
    # The next step begins with what this one left, but for the content.
    replace(str(step))
    assert os.listdir(folder) == ["out"], (step, os.listdir(folder))
print(step)
"""


@FORKS
@pytest.mark.parametrize("mode", ["file", "exchanged", "moved aside"])
def test_killed_at_any_step_the_old_output_or_the_new_one_is_there(
    tmp_path: Path, mode: str
) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path), mode]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) > 8
    assert os.listdir(tmp_path) == ["out"]


def test_what_is_in_the_way_of_the_temporary_folder_stays(tmp_path: Path) -> None:
    (tmp_path / ".out.part").mkdir()
    (tmp_path / ".out.part" / "mine").touch()
    with pytest.raises(OutputError, match=r"\.out\.part: is in the way"):
        write(tmp_path / "out")
    assert (tmp_path / ".out.part" / "mine").exists()
    assert os.listdir(tmp_path) == [".out.part"]


def test_outputs_below_a_file_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        check_output(tmp_path / "file" / "a.png", IMAGE)


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


def test_ctrl_c_right_after_the_temporary_folder_is_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Path.mkdir

    def interrupted_mkdir(folder: Path, *more: Any, **options: Any) -> None:
        make(folder, *more, **options)
        if folder.name == ".out.part":
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Path, "mkdir", interrupted_mkdir)
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / "out")
    assert not os.listdir(tmp_path)


def test_a_claim_within_a_claim_spares_the_outer_ones_folder(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out", CAPTURE) as part:
        (part / "capture.json").write_text("outer")
        with pytest.raises(OutputError, match="cannot be written"):
            write(tmp_path / "out")
        assert (part / "capture.json").read_text() == "outer"
    assert (tmp_path / "out" / "capture.json").read_text() == "outer"


def test_clean_up_is_claimed_only_when_it_was_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(*_: object) -> None:
        raise OSError(errno.EBUSY, "Device or resource busy")

    def fail() -> OutputError:
        with pytest.raises(OutputError) as error, atomic_folder(tmp_path / "out", CAPTURE):
            raise OSError(errno.ENOSPC, "No space left on device")
        return error.value

    assert "nothing was left behind" in str(fail())
    assert not os.listdir(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", busy)
        assert ".out.part could not be removed" in str(fail())
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


def test_endings_in_capitals(tmp_path: Path) -> None:
    write_image(tmp_path / "a.PNG", np.zeros((2, 2)))
    with atomic_file(tmp_path / "T.NPZ", NPZ) as part:
        np.savez(part, lightmatrix_transport=np.array(1))
    with atomic_file(tmp_path / "T.NPZ", NPZ, overwrite=True) as part:
        np.savez(part, lightmatrix_transport=np.array(1))
    assert sorted(os.listdir(tmp_path)) == ["T.NPZ", "a.PNG"]
    assert read_image(tmp_path / "a.PNG").shape == (2, 2)


# ---- locks


HOLDER = """
import sys
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
            process.kill()


def test_two_processes_do_not_write_one_output(
    tmp_path: Path, holder: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "out" / ".." / "out")
    assert main(["patterns", "bernoulli", "-k", "2", "--size", "4x4", "-o", f"{tmp_path}/out"]) == 2
    told = capsys.readouterr().err
    assert f"is being written by process {holder.pid} on" in told
    assert "-c" in told
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
    found: list[BaseException] = []

    def other() -> None:
        try:
            write(tmp_path / "out")
        except OutputError as error:
            found.append(error)

    with claimed(tmp_path / "out", CAPTURE), claimed(tmp_path / "out", CAPTURE):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        write(tmp_path / "out")
    assert "is being written by" in str(found[0])
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


# ---- running results


def test_running_results_are_kept_found_and_removed(tmp_path: Path) -> None:
    kept = RunningResults.open(tmp_path / "out", ".cases")
    with kept.keep("a.json") as part:
        part.write_text("1")
    with pytest.raises(OutputError, match="cannot be written"), kept.keep("b.json"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with kept.keep("c.json") as part:
        part.write_text("3")
    # As a killed run leaves it.
    (kept.path / ".b.0123abcd.part.json").touch()
    (kept.path / "d.json").write_text("of somebody else")
    again = RunningResults.open(tmp_path / "out", ".cases")
    assert again.names == ["a.json", "c.json"]
    assert not again.has("d.json")
    again.forget("d.json")
    assert again.file("d.json").exists()
    with pytest.raises(OutputError, match="not written by lightmatrix"), again.keep("d.json"):
        pass
    with pytest.warns(LightMatrixWarning, match=r"holds d\.json"):
        again.discard()
    assert sorted(os.listdir(again.path)) == [".lightmatrix", "d.json"]
    (again.path / "d.json").unlink()
    RunningResults.open(tmp_path / "out", ".cases").discard()
    assert not os.listdir(tmp_path)


def test_running_folders_of_others_are_refused_at_once(tmp_path: Path) -> None:
    kind = FolderKind("figure", running=".cases")
    (tmp_path / "out.cases").mkdir()
    check_output(tmp_path / "out", kind)
    (tmp_path / "out.cases" / "mine").touch()
    with pytest.raises(OutputError, match=r"out\.cases: .*not written by lightmatrix"):
        check_output(tmp_path / "out", kind)
    shutil.rmtree(tmp_path / "out.cases")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out.cases").symlink_to("elsewhere")
    with pytest.raises(OutputError, match=r"out\.cases"):
        check_output(tmp_path / "out", kind)


@dataclass(frozen=True)
class Case:
    name: str = "one"


DRAWN = Experiment(
    "figure",
    lambda quick: [Case()],
    lambda case: Measured([{"name": case.name}]),
    lambda out, found: None,
)


def test_experiments_touch_nothing_but_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "EXPERIMENTS", dict.fromkeys(run.EXPERIMENTS, DRAWN))
    Path("out.cases").mkdir()
    Path("out.cases/mine").touch()
    assert main(["experiment", "fig4", "-o", "out"]) == 2
    assert Path("out.cases/mine").exists()
    assert not Path("out").exists()
    assert main(["experiment", "few-patterns", "-o", "few"]) == 0
    assert main(["experiment", "few-patterns", "-o", "few"]) == 2
    assert main(["experiment", "few-patterns", "-o", "few", "--overwrite"]) == 0
    assert sorted(os.listdir()) == ["few", "out.cases"]


# ---- the command line


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with patterns p and a capture cap."""
    folder = tmp_path_factory.mktemp("work")
    made = f"patterns bernoulli -k 16 --size 64x64 -o {folder}/p"
    taken = f"simulate l_objects --patterns {folder}/p -o {folder}/cap"
    assert [main(line.split()) for line in (made, taken)] == [0, 0]
    return folder


@pytest.mark.parametrize(
    "line",
    [
        "patterns bernoulli -k 0 --size 4x4 -o new/p",
        "patterns hadamard --size 5x5 -o new/p",
        "patterns bernoulli --size 4x4 -o link",
        "patterns bernoulli --size 4x4 -o . --overwrite",
        "simulate l_objects --patterns none -o new/cap",
        "simulate no_scene --patterns p -o new/cap",
        "simulate l_objects --patterns p --exposure dark -o new/cap",
        "estimate none -o new/s.zarr",
        "estimate cap -o new/s.zarr --regularization 0",
        "estimate cap -o new/s.zarr --regularization nan",
        "estimate cap -o new/s.zarr --solver admm --regularization -1",
        "estimate cap -o new/s.zarr --bin-camera 0",
        "estimate cap -o link/s.zarr",
        "export none.zarr new/T.NPZ",
        "relight none.zarr p/pattern_0000.png -o new/out.PNG",
        "render no_scene --size 8x8 -o new/T.NPZ",
    ],
)
def test_refused_commands_leave_nothing(
    line: str,
    work: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(work, tmp_path, dirs_exist_ok=True)
    (tmp_path / "link").symlink_to("nowhere/x")
    before = snapshot(tmp_path)
    assert main(line.split()) == 2
    assert "error: " in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_overwrite_spares_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cap/images").mkdir(parents=True)
    Path("cap/images/photo.png").touch()
    Path("cap/capture.json").write_text(json.dumps({"format": "lightmatrix-capture", "version": 1}))
    before = snapshot(tmp_path)
    assert (
        main(["patterns", "bernoulli", "-k", "2", "--size", "8x8", "-o", "cap", "--overwrite"]) == 2
    )
    assert snapshot(tmp_path) == before


def test_the_temporary_folder_is_named_for_its_output(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out", CAPTURE):
        assert sorted(os.listdir(tmp_path)) == [".out.lock", ".out.part"]
        content = json.loads((tmp_path / ".out.part" / ".lightmatrix").read_text())
        assert content["format"] == outputs.TEMPORARY
