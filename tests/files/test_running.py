"""Running results: kept beside an output, resumed, and removed when it is whole."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.files.kinds import FolderKind
from lightmatrix.files.running import RunningResults
from lightmatrix.files.writing import check_output


def test_running_results_are_kept_resumed_and_removed(tmp_path: Path) -> None:
    kept = RunningResults.open(tmp_path / "out", ".cases")
    with kept.keep("a.json") as part:
        part.write_text("1")
    with pytest.raises(OutputError, match="cannot be written"), kept.keep("b.json"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with kept.keep("c.json") as part:
        part.write_text("3")
    # As a killed run leaves it.
    (kept.path / ".0123abcd.part.json").touch()
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


SETTINGS = {"regularization": 0.3, "capture": "0123456789abcdef", "solver": {"rows": 4}}


def resume(folder: Path, settings: dict[str, Any], overwrite: bool = False) -> RunningResults:
    running = RunningResults.resume(
        folder / "out",
        ".partial",
        settings,
        file="settings.json",
        key="wanted",
        contents="frames of another capture",
        overwrite=overwrite,
    )
    if not running.has("settings.json"):
        with running.keep("settings.json") as part:
            part.write_text(json.dumps({"wanted": settings}))
    return running


def test_results_continue_under_the_same_settings_only(tmp_path: Path) -> None:
    # Without results, other settings may begin anew.
    assert resume(tmp_path, {}).names == ["settings.json"]
    with resume(tmp_path, SETTINGS).keep("frame") as part:
        part.write_text("one")
    assert resume(tmp_path, SETTINGS).names == ["settings.json", "frame"]
    words = r"partial: holds frames of another capture \(.*; regularization was 0.3, is not given"
    with pytest.raises(OutputError, match=words):
        resume(tmp_path, {})
    assert resume(tmp_path, {}, overwrite=True).names == ["settings.json"]
