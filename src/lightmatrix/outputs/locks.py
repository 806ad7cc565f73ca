"""Locks of outputs that are being written: one process at a time, and who it is.

The lock is the kernel's (flock) on a small file beside the output, so that it ends with its owner
however that ends; a file that a dead process left is taken over. Libraries for this do not say who
holds a lock that the kernel frees, so it is done here.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import shlex
import stat
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from lightmatrix.errors import LightMatrixWarning, OutputError
from lightmatrix.outputs.markers import printable
from lightmatrix.outputs.system import (
    CAREFULLY,
    read_start,
    remove_locked,
    try_lock,
    write_whole,
)
from lightmatrix.outputs.targets import explained

FORMAT, VERSION = "lightmatrix-lock", 1
# Who asks only whether an output is locked holds the lock for a moment too.
_PATIENCE = 0.2
_MOST_BYTES = 1 << 16
_UNSUPPORTED = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}


@dataclass
class _Held:
    file: int
    thread: int
    # Whether the kernel holds it; some network file systems know no locks.
    firm: bool
    times: int = 1


_held: dict[Path, _Held] = {}
_guard = threading.Lock()


def _forget() -> None:
    # A forked child would otherwise keep its parent's locks alive after the parent's death.
    for held in _held.values():
        os.close(held.file)
    _held.clear()


if hasattr(os, "register_at_fork"):  # Windows knows no forks.
    os.register_at_fork(after_in_child=_forget)


@contextmanager
def locked(target: Path) -> Iterator[bool]:
    """Hold the lock of an output; a thread that holds it already just goes on.

    Parameters
    ----------
    target : Path
        The output, not a link; its folder exists.

    Yields
    ------
    bool
        Whether it was taken just now and firmly, so that what lies half-written beside the output
        belongs to no living process.

    Raises
    ------
    OutputError
        If another process or thread holds it (saying which), or the lock cannot be made.
    """
    with _guard:
        held = _held.get(target)
        if held is not None and held.thread == threading.get_ident():
            held.times += 1
            first = False
        elif held is not None:
            raise _refusal(target, "another thread of this process")
        else:
            with explained(target):
                held = _held[target] = _acquire(target)
            first = held.firm
    try:
        yield first
    finally:
        with _guard:
            held.times -= 1
            # In a forked child it is not there any more.
            if held.times == 0 and _held.pop(target, None) is not None:
                remove_locked(lock_file(target), held.file)


def check_unlocked(target: Path) -> None:
    """Refuse an output that somebody else is writing; makes nothing.

    Raises
    ------
    OutputError
        Saying who holds its lock.
    """
    with _guard:
        if target in _held and _held[target].thread == threading.get_ident():
            return
    try:
        file = os.open(lock_file(target), os.O_RDONLY | CAREFULLY)
    except OSError:
        return
    try:
        try_lock(file, shared=True)
    except BlockingIOError:
        raise _refusal(target, _owner(file)) from None
    except OSError:
        return
    finally:
        os.close(file)


def lock_file(target: Path) -> Path:
    """The file beside an output that is locked while it is written."""
    return target.with_name(f".{target.name}.lock")


def _acquire(target: Path) -> _Held:
    path = lock_file(target)
    flags = os.O_RDWR | os.O_CREAT | CAREFULLY
    deadline = time.monotonic() + _PATIENCE
    while True:
        file = os.open(path, flags, 0o666)
        try:
            firm = _try(file, target, deadline)
            # Its owner may have removed the file between our opening and locking it.
            if firm is not None and _is_there(path, file):
                _check_ours(path, file)
                _sign(path, file)
                return _Held(file, threading.get_ident(), firm)
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _try(file: int, target: Path, deadline: float) -> bool | None:
    """Lock an open file: firmly (True), not at all (False), or not yet (None)."""
    try:
        try_lock(file)
        return True
    except BlockingIOError:
        if time.monotonic() > deadline:
            raise _refusal(target, _owner(file)) from None
        time.sleep(0.01)
        return None
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        warnings.warn(
            f"{target}: its file system knows no locks; make sure that nothing else writes it",
            LightMatrixWarning,
            stacklevel=2,
        )
        return False


def _is_there(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(os.lstat(path), os.fstat(file))
    except FileNotFoundError:
        return False


def _check_ours(path: Path, file: int) -> None:
    regular = stat.S_ISREG(os.fstat(file).st_mode)
    if not regular or (os.fstat(file).st_size and _read(file) is None):
        raise OutputError(
            f"{path}: is in the way of a lock and was not written by lightmatrix",
            hint="move it elsewhere, or choose another name for the output",
        )


def _sign(path: Path, file: int) -> None:
    content = {
        "format": FORMAT,
        "version": VERSION,
        "pid": os.getpid(),
        "host": platform.node(),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:500],
    }
    try:
        write_whole(file, (json.dumps(content) + "\n").encode())
    except OSError:
        path.unlink(missing_ok=True)
        raise


def _read(file: int) -> dict[str, object] | None:
    try:
        content = json.loads(read_start(file, _MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and content.get("format") == FORMAT else None


def _owner(file: int) -> str:
    content = _read(file)
    if content is None:
        return "another process"
    words = f"process {content.get('pid')} on {content.get('host')} since {content.get('since')}"
    return printable(f"{words} ({content.get('command')})")


def _refusal(target: Path, owner: str) -> OutputError:
    return OutputError(
        f"{target}: is being written by {owner}",
        hint="wait for it to end, or choose another name for the output",
    )
