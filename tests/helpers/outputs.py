"""Small outputs, and what lies in a folder, for tests of outputs."""

from __future__ import annotations

import stat
from pathlib import Path

from lightmatrix.files.kinds import FileKind, FolderKind
from lightmatrix.files.writing import atomic_folder

CAPTURE = FolderKind("capture")
TEXT = FileKind("text", (), (b"ours",))


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
    """Every entry below a folder, with its kind and content."""
    entries = {}
    for path in sorted(folder.rglob("*")):
        kind = stat.S_IFMT(path.lstat().st_mode)
        content = path.read_bytes().hex() if kind == stat.S_IFREG else ""
        entries[str(path.relative_to(folder))] = f"{kind} {content}"
    return entries
