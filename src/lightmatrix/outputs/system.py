"""What differs between systems where files are locked and moved: Linux and macOS, and Windows."""

from __future__ import annotations

import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

# Neither follow links nor wait for pipes, where the system has such; no ends of lines changed.
CAREFULLY = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
# Windows keeps others from reading what is locked: a byte far behind all that is written.
_FAR = 1 << 30


def try_lock(file: int, *, shared: bool = False) -> None:
    """Lock an open file for this process, until it is closed.

    Parameters
    ----------
    file : int
        Its descriptor.
    shared : bool
        Whether others may lock it so too; Windows knows no such lock.

    Raises
    ------
    BlockingIOError
        If another process holds a lock.
    OSError
        If the file system knows no locks.
    """
    if sys.platform == "win32":
        os.lseek(file, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None
    else:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def read_start(file: int, most: int) -> bytes:
    """The first bytes of an open file."""
    os.lseek(file, 0, os.SEEK_SET)
    return os.read(file, most)


def write_whole(file: int, content: bytes) -> None:
    """Put a little content in place of all that an open file holds."""
    os.ftruncate(file, 0)
    os.lseek(file, 0, os.SEEK_SET)
    os.write(file, content)


def remove_locked(path: Path, file: int) -> None:
    """Remove a file that this process holds open and locked, and let go of it."""
    if sys.platform == "win32":
        # An open file cannot be removed there; who opened it meanwhile keeps it.
        os.close(file)
        try:
            path.unlink(missing_ok=True)
        except PermissionError:
            return
    else:
        path.unlink(missing_ok=True)
        os.close(file)


def rename_folder(folder: Path, target: Path) -> None:
    """Give a folder a name at which there is nothing, or an empty folder."""
    if sys.platform == "win32":
        # Nothing is renamed there onto what exists.
        if target.exists():
            target.rmdir()
    folder.rename(target)
