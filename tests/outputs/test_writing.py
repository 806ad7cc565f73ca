"""Outputs are whole or absent, and the old one stays until the new one is whole."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightmatrix.errors import OutputError
from lightmatrix.files.images import read_image, write_image
from lightmatrix.outputs import writing as outputs
from lightmatrix.outputs.kinds import IMAGE, NPZ
from lightmatrix.outputs.writing import atomic_file, atomic_folder, check_output, claimed
from tests.helpers.limits import largest_file
from tests.helpers.systems import FORKS, LIMITS

if sys.platform != "win32":
    pass
from tests.helpers.outputs import CAPTURE, interrupted, snapshot, write

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


def test_the_temporary_folder_is_named_for_its_output(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out", CAPTURE):
        assert sorted(os.listdir(tmp_path)) == [".out.lock", ".out.part"]
        content = json.loads((tmp_path / ".out.part" / ".lightmatrix").read_text())
        assert content["format"] == outputs.TEMPORARY
