"""Running results: finished parts of an output, kept beside it until it is whole.

A running folder carries a marker of lines: the first says what it is, each further one names a file
that was kept in it. Only those files are ever read, replaced or removed. Other processes may put
files there too, once the one that holds the folder has written their names down.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.outputs.markers import MARKER, printable
from lightmatrix.outputs.targets import explained

FORMAT, VERSION = "lightmatrix-running", 1
# What a file is called until it is whole: its name, around a number that no other writer has.
_PUT = re.compile(r"\.(.+)\.[0-9a-f]{8}\.part(\.[^.]*)?")


class RunningFolder:
    """Files that are kept while an output is made; made by `open`.

    The caller holds the lock of the output (`lightmatrix.outputs.writing.claimed`).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._names = _names(path)

    @classmethod
    def open(cls, target: Path, ending: str) -> Self:
        """Begin, or go on with, the running results of an output.

        Parameters
        ----------
        target : Path
            The output, as `claimed` gives it.
        ending : str
            What the folder's name has after the output's, such as ".partial".

        Raises
        ------
        OutputError
            If there is a folder of that name that is not ours, or the disk fails.
        """
        folder = check_running(target, ending)
        with explained(folder):
            folder.mkdir(exist_ok=True)
            if not (folder / MARKER).exists() or not (folder / MARKER).stat().st_size:
                header = {"format": FORMAT, "version": VERSION, "output": target.name}
                (folder / MARKER).write_text(json.dumps(header))
        running = cls(folder)
        running._sweep()
        return running

    @property
    def names(self) -> list[str]:
        """Names of the files that are kept, in the order in which they came first."""
        return [name for name in self._names if self.file(name).is_file()]

    def file(self, name: str) -> Path:
        """Where a kept file lies, or would."""
        return self.path / name

    def has(self, name: str) -> bool:
        """Whether a file of that name is kept."""
        return name in self._names and self.file(name).is_file()

    def place(self, name: str) -> Path:
        """Where another process may `put` a file of that name, which is written down now.

        Raises
        ------
        OutputError
            If the disk fails, or there is a file of that name that was not kept by us.
        """
        with explained(self.file(name)):
            self._list(name)
        return self.file(name)

    @contextmanager
    def keep(self, name: str) -> Iterator[Path]:
        """Write a file at a temporary path with the same ending, kept as `name` on success.

        Raises
        ------
        OutputError
            If the disk fails, or there is a file of that name that was not kept by us.
        """
        with put(self.place(name)) as part:
            yield part

    def forget(self, name: str) -> None:
        """Remove a kept file, if it is there."""
        if name in self._names:
            self.file(name).unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove what was kept, and the folder if nothing else is in it."""
        with suppress(OSError):
            for name in self._names:
                self.file(name).unlink(missing_ok=True)
            self._sweep()
            foreign = sorted(set(os.listdir(self.path)) - {MARKER})
            if not foreign:
                (self.path / MARKER).unlink()
                self.path.rmdir()
                return
            warnings.warn(
                f"{self.path}: not removed, it holds {printable(foreign[0])}, "
                "which was not written by lightmatrix",
                LightMatrixWarning,
                stacklevel=2,
            )

    def _list(self, name: str) -> None:
        """Write a name down before its file appears."""
        if name in self._names:
            return
        if os.path.lexists(self.file(name)):
            raise OutputError(
                f"{self.file(name)}: was not written by lightmatrix", hint="move it elsewhere"
            )
        with (self.path / MARKER).open("a") as marker:
            # The line break first: a line that a full disk cut off spoils none but itself.
            marker.write("\n" + json.dumps(name))
        self._names.append(name)

    def _sweep(self) -> None:
        """Remove what killed processes left half-written."""
        known = set(self._names)
        for entry in os.listdir(self.path):
            found = _PUT.fullmatch(entry)
            if found is not None and f"{found[1]}{found[2] or ''}" in known:
                (self.path / entry).unlink(missing_ok=True)


@contextmanager
def put(file: Path) -> Iterator[Path]:
    """Write a file where `RunningFolder.place` said, also from a process that does not hold it.

    Yields
    ------
    Path
        A temporary path with the same ending, of this writer alone: two may write the same file,
        where one was taken for dead. It is renamed on success.

    Raises
    ------
    OutputError
        If the disk fails.
    """
    part = file.with_name(f".{file.stem}.{secrets.token_hex(4)}.part{file.suffix}")
    with explained(file):
        try:
            yield part
            with part.open("rb+") as written:
                os.fsync(written.fileno())
            os.replace(part, file)
        finally:
            part.unlink(missing_ok=True)


def check_running(target: Path, ending: str) -> Path:
    """The folder of an output's running results, if it is ours or does not exist; makes nothing.

    Raises
    ------
    OutputError
        If something else has its name.
    """
    folder = target.with_name(target.name + ending)
    with explained(folder):
        if not os.path.lexists(folder) or _is_ours(folder):
            return folder
    raise OutputError(
        f"{folder}: stands where the running results would go, and was not written by lightmatrix",
        hint="move it elsewhere, or choose another name for the output",
    )


def _is_ours(folder: Path) -> bool:
    if folder.is_symlink() or not folder.is_dir():
        return False
    marker = folder / MARKER
    inside = list(folder.iterdir())
    # A run that was killed before the marker was whole had kept nothing.
    if not inside or (inside == [marker] and not marker.lstat().st_size):
        return True
    header = _lines(marker)[:1]
    return bool(header) and isinstance(header[0], dict) and header[0].get("format") == FORMAT


def _names(folder: Path) -> list[str]:
    found = [name for name in _lines(folder / MARKER)[1:] if isinstance(name, str)]
    # Only names of files right in the folder: a marker is read, not trusted.
    return [name for name in dict.fromkeys(found) if name == Path(name).name and name != MARKER]


def _lines(marker: Path) -> list[object]:
    """What the lines of a marker say; None for one that cannot be read."""
    if marker.is_symlink() or not marker.is_file():
        return []
    text = marker.read_text(encoding="utf-8", errors="replace")
    return [_line(line) for line in text.split("\n")]


def _line(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
