"""A real disk that can be made full: a small file system of its own, where root may mount one."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_PLENTY = 64 << 20


@dataclass
class SmallDisk:
    """A mounted disk."""

    folder: Path

    def leave(self, room: int) -> None:
        """Let so many bytes more be written, in whole pages of memory; `free` ends it."""
        status = os.statvfs(self.folder)
        used = (status.f_blocks - status.f_bfree) * status.f_frsize
        # A size of 0 is no limit.
        self._resize(max(used + room, status.f_frsize))

    def free(self) -> None:
        """Let there be plenty."""
        self._resize(_PLENTY)

    def _resize(self, size: int) -> None:
        _run("mount", "-o", f"remount,size={size}", str(self.folder))


@contextmanager
def small_disk(folder: Path) -> Iterator[SmallDisk | None]:
    """A disk mounted at a folder, empty; None where that is not allowed."""
    try:
        _run("mount", "-t", "tmpfs", "-o", f"size={_PLENTY}", "lightmatrix-test", str(folder))
    except (OSError, subprocess.CalledProcessError):
        yield None
        return
    try:
        yield SmallDisk(folder)
    finally:
        _run("umount", "--lazy", str(folder))


def _run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)
