"""What an output may replace: only what lightmatrix wrote, and no special place."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.errors import OutputError
from lightmatrix.files.kinds import IMAGE, MAT, NPZ, FileKind, FolderKind, OutputKind
from lightmatrix.files.writing import atomic_folder, check_output
from tests.helpers.outputs import CAPTURE, TEXT, interrupted, snapshot, write
from tests.helpers.systems import PIPES


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
CHANGES = st.sampled_from(["add", "link", "folder link", "pipe", "longer", "unmark", "nothing"])


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
        elif change == "longer":
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
        # It has the null device's numbers, so that whatever happens to it does no harm.
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
        with pytest.raises(OutputError, match="a device, a pipe or a socket"):
            check_output(name, kind, overwrite=True)
    with pytest.raises(OutputError, match=r"is not a folder|Not a directory"):
        check_output("special/a", kind)
    assert snapshot(tmp_path) == before


def test_places_that_are_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("here", "home", "other"):
        write(tmp_path / name / "in")
        (tmp_path / f"to {name}").symlink_to(name)
    monkeypatch.chdir(tmp_path / "here" / "in")
    for name in ("HOME", "USERPROFILE"):  # POSIX and Windows look for it here.
        monkeypatch.setenv(name, str(tmp_path / "home" / "in"))
    words = {"here": "the current folder", "home": "the home folder"}
    for name, reason in words.items():
        for path in (tmp_path / name / "in", tmp_path / name, tmp_path / f"to {name}"):
            with pytest.raises(OutputError, match=reason):
                check_output(path, CAPTURE, overwrite=True)
    for text in (".", "", "..", "../..", "/", "new/..", "../in/."):
        with pytest.raises(OutputError, match="never replaced"):
            check_output(text, CAPTURE, overwrite=True)
    check_output(tmp_path / "other" / "in", CAPTURE, overwrite=True)
    (tmp_path / "other" / "in" / "disk").mkdir()
    disk = str(tmp_path / "other" / "in" / "disk")
    monkeypatch.setattr(os.path, "ismount", lambda place: str(place) == disk)
    for name in ("other/in", "other/in/disk"):
        with pytest.raises(OutputError, match=r"disk is mounted|holds disk"):
            check_output(tmp_path / name, CAPTURE, overwrite=True)


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
