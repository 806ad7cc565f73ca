"""How lightmatrix recognizes outputs that it wrote.

A folder of ours carries a marker: a JSON object that holds the name of the format, the kind of the
output, and every file in it with its size and its digest. A folder without a marker, with a file
that is not listed, or with one of another content (edited since) is not ours alone and is never
replaced. A single file is recognized by its content.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightmatrix.errors import OutputError
from lightmatrix.outputs.targets import ANOTHER_NAME

MARKER = ".lightmatrix"
FORMAT, VERSION = "lightmatrix-output", 1
# A folder holds its marker in one of two places: a JSON file, and the keys that lead to it inside.
IN_FILE, IN_ZARR = (MARKER,), ("zarr.json", "attributes", "output")
# Bytes of the largest JSON file that is read in search of a marker, far more than any marker takes.
_MOST_BYTES = 1 << 28
# Digests of files by what the system says of them, because an output is checked before the work
# and again after it. At most so many are kept.
_digests: dict[tuple[int, ...], str] = {}
_MOST_DIGESTS = 1 << 17


@dataclass(frozen=True)
class FolderKind:
    """A kind of output that is a folder."""

    # In words, such as "capture"; stands in the marker.
    name: str
    # Permitted endings, in lower case; empty permits any.
    suffixes: tuple[str, ...] = ()
    # The JSON file that holds the marker, then the keys that lead to it inside.
    marker: tuple[str, ...] = IN_FILE
    # Ending of the folder beside the output for its running results; empty if none.
    running: str = ""

    def check_replaceable(self, shown: Path, target: Path) -> bool:
        """Whether a folder of ours may be replaced; False if it is just empty."""
        if not target.is_dir():
            raise OutputError(
                f"{shown}: is a file, the output is a folder ({self.name})", hint=ANOTHER_NAME
            )
        if not any(target.iterdir()):
            return False
        marker = _read_marker(target, self.marker)
        other = _read_marker(target, IN_FILE if self.marker == IN_ZARR else IN_ZARR)
        if marker is None and other is None:
            raise OutputError(
                f"{shown}: is a folder that was not written by lightmatrix "
                "(or before folders were marked)",
                hint=f"{ANOTHER_NAME}, or remove the folder yourself",
            )
        kind, files, digests = marker or other or ("", {}, {})
        if marker is None or kind != self.name:
            raise OutputError(
                f"{shown}: holds a {kind}, the output is a {self.name}",
                hint=f"{ANOTHER_NAME}, or remove the folder yourself",
            )
        for name, size in sizes_below(target):
            if name != self.marker[0] and name not in files:
                problem = f"holds {printable(name)}, which was not written by lightmatrix"
            elif size != files.get(name, size) or self._is_edited(target, name, digests):
                problem = f"{printable(name)} in it was changed since lightmatrix wrote it"
            else:
                continue
            raise OutputError(
                f"{shown}: {problem}", hint=f"{ANOTHER_NAME}, or move that file elsewhere"
            )
        return True

    def mark(self, folder: Path) -> None:
        """Write the marker of a finished folder."""
        files = {name: size for name, size in sizes_below(folder) if name != self.marker[0]}
        digests = {name: _digest(folder / name) for name, size in files.items() if size >= 0}
        content: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "kind": self.name,
            "files": files,
            "digests": digests,
        }
        file = folder / self.marker[0]
        whole: Any = content
        if len(self.marker) > 1:
            inner = whole = json.loads(file.read_text(encoding="utf-8"))
            digests[self.marker[0]] = self._digest_beside_marker(whole)
            for key in self.marker[1:-1]:
                inner = inner[key]
            inner[self.marker[-1]] = content
        # In one step, since a folder that is in use may be marked again.
        written = file.with_name(f"{file.name}.new")
        written.write_text(json.dumps(whole, indent=1) + "\n")
        os.replace(written, file)

    def _is_edited(self, folder: Path, name: str, digests: dict[str, Any]) -> bool:
        """Whether a file has another content than was written; outputs of old have no digests."""
        if name not in digests:
            return False
        if name == self.marker[0]:
            return digests[name] != self._digest_beside_marker(read_object(folder / name))
        return digests[name] != _digest(folder / name)

    def _digest_beside_marker(self, content: Any) -> str:
        """The digest of what else the JSON file with the marker holds."""
        copy = inner = json.loads(json.dumps(content))
        for key in self.marker[1:-1]:
            inner = inner[key]
        inner.pop(self.marker[-1], None)
        return hashlib.sha256(json.dumps(copy, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class FileKind:
    """A kind of output that is one file."""

    name: str
    suffixes: tuple[str, ...]
    # Whether a file is of this kind by its content. An exception counts as no.
    recognize: Callable[[Path], bool]
    running: str = ""

    def check_replaceable(self, shown: Path, target: Path) -> bool:
        """Whether a file may be replaced: True, or OutputError if it is of another kind."""
        if target.is_dir():
            raise OutputError(
                f"{shown}: is a folder, the output is a file ({self.name})", hint=ANOTHER_NAME
            )
        if target.stat().st_size == 0:
            return True
        try:
            ours = self.recognize(target)
        # Readers raise nearly anything on files of other kinds.
        except Exception:
            ours = False
        if not ours:
            raise OutputError(
                f"{shown}: is a file that was not written by lightmatrix as {self.name}",
                hint=f"{ANOTHER_NAME}, or remove the file yourself",
            )
        return True


OutputKind = FolderKind | FileKind


def _read_marker(
    folder: Path, place: tuple[str, ...]
) -> tuple[str, dict[str, Any], dict[str, Any]] | None:
    """Kind, files and digests (none if older) by a folder's marker; None without our marker."""
    content = read_object(folder / place[0])
    for key in place[1:]:
        content = content.get(key) if isinstance(content, dict) else None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return None
    files, digests = content.get("files"), content.get("digests", {})
    if not isinstance(files, dict) or not isinstance(digests, dict):
        return None
    return printable(str(content.get("kind"))), files, digests


def holds_member(file: Path, name: str) -> bool:
    """Whether an npz has an array of that name, which we write first: files may be cut off."""
    member = f"{name}.npy".encode()
    with file.open("rb") as opened:
        start = opened.read(30 + len(member))
    # 30 bytes of a ZIP file stand before the name of the first member.
    if start.startswith(b"PK\x03\x04") and start[30:] == member:
        return True
    with zipfile.ZipFile(file) as archive:
        return f"{name}.npy" in archive.namelist()


def sizes_below(folder: Path) -> Iterator[tuple[str, int]]:
    """Path and size of all but folders in a folder; -1 for links, pipes and devices."""
    for place, folders, files in os.walk(folder, onerror=_raise):
        folders.sort()
        inner = Path(place)
        links = [name for name in folders if (inner / name).is_symlink()]
        for name in sorted([*files, *links]):
            path = inner / name
            regular = path.is_file() and not path.is_symlink()
            yield path.relative_to(folder).as_posix(), path.stat().st_size if regular else -1


def read_object(file: Path) -> dict[str, Any] | None:
    """A JSON object from a file that may be anything; None if it holds none."""
    try:
        if file.is_symlink() or not file.is_file() or file.stat().st_size > _MOST_BYTES:
            return None
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _digest(file: Path) -> str:
    """The SHA-256 of a file, which is read only if it was changed since it was last asked for."""
    with file.open("rb") as stream:
        facts = os.fstat(stream.fileno())
        key = (facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns)
        if key not in _digests:
            if len(_digests) >= _MOST_DIGESTS:
                _digests.clear()
            _digests[key] = hashlib.file_digest(stream, "sha256").hexdigest()
    return _digests[key]


def printable(text: str) -> str:
    """A name or command without characters that would disturb a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _raise(error: OSError) -> None:
    raise error
