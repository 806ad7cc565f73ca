"""Puts a new folder in the place of an old one, in one step where the system can do that."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

# Arguments of Linux's renameat2: paths count from the current folder, and change places.
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
# The errors of kernels and file systems that cannot exchange paths.
_UNSUPPORTED = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}


def put_in_place(new: Path, target: Path, aside: Path) -> None:
    """Let a whole folder replace `target`, whose old folder ends at `new` if the two can swap."""
    if not os.path.lexists(target):
        os.rename(new, target)
    elif not any(target.iterdir()):
        # Windows renames nothing onto what exists.
        target.rmdir()
        os.rename(new, target)
    elif not exchange(new, target):
        os.rename(target, aside)
        try:
            os.rename(new, target)
        except OSError:
            os.rename(aside, target)
            raise


def exchange(one: Path, other: Path) -> bool:
    """Let two paths change places, so that neither is ever missing; False where that is unknown."""
    if not sys.platform.startswith("linux"):
        return False
    # Python has no function for it.
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    paths = (os.fsencode(one), os.fsencode(other))
    if rename(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(other))
