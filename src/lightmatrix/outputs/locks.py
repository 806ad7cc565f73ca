"""Locks of outputs: one thread of one process writes an output at a time, and others learn who.

filelock holds the operating system's lock on ``.NAME.lock`` beside the output, so the lock ends
with its owner, however that ends. filelock keeps neither of two promises that users rely on, so
they are kept here: the file names its owner, and no lock file stays behind.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout, lock_descriptor

from lightmatrix.errors import OutputError, warn
from lightmatrix.outputs.markers import printable
from lightmatrix.outputs.targets import as_output_error

FORMAT, VERSION = "lightmatrix-lock", 1
# A lock counts as held by another process after 0.2 s, in which it is tried every 0.01 s. Both were
# chosen by hand: `check_unlocked` of another process holds it for less than a millisecond.
_PATIENCE, _POLL = 0.2, 0.01
# A lock file of ours takes less than 1000 bytes. No more than this is read of any.
_MOST_BYTES = 1 << 16
# The errors of file systems without locks, some network file systems among them.
_UNSUPPORTED = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
# Neither follow a link nor wait for a pipe. Windows has neither flag.
_OPEN_FLAGS = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


@contextmanager
def locked(target: Path) -> Iterator[bool]:
    """Hold the lock of an output, not a link; a thread that holds it may take it again.

    Yields whether the lock is new and works, so that what lies half-written beside the output
    belongs to no living process. An OutputError says who else holds it.
    """
    lock = _lock(target)
    with as_output_error(target):
        if not lock.is_locked:
            _check_ours(lock_file(target))
        works = _acquire(lock, target)
    try:
        yield works and lock.lock_counter == 1
    finally:
        if works:
            _release(lock, target)


def check_unlocked(target: Path) -> None:
    """Refuse an output that another process or thread is writing; makes nothing."""
    if _lock(target).is_locked:
        return
    try:
        file = os.open(lock_file(target), _OPEN_FLAGS)
    except OSError:
        return
    deadline = time.monotonic() + _PATIENCE
    try:
        # An open file, since a FileLock would make the file that it locks.
        while not lock_descriptor(file, blocking=False):
            if time.monotonic() > deadline:
                raise _refusal(target)
            time.sleep(_POLL)
    except OSError:
        return
    finally:
        os.close(file)


def lock_file(target: Path) -> Path:
    """The file beside an output that is locked while it is written."""
    return target.with_name(f".{target.name}.lock")


def _lock(target: Path) -> FileLock:
    # filelock keeps one object for each path while it is held, which counts for each thread.
    return FileLock(
        lock_file(target),
        timeout=_PATIENCE,
        poll_interval=_POLL,
        is_singleton=True,
        on_acquired=_sign,
    )


def _acquire(lock: FileLock, target: Path) -> bool:
    """Take a lock; False where the file system has none."""
    try:
        lock.acquire()
    except Timeout:
        _check_place(target)
        raise _refusal(target) from None
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        lock_file(target).unlink(missing_ok=True)
        warn(
            f"{target}: its file system has no locks; make sure that nothing else writes it",
        )
        return False
    return True


def _check_place(target: Path) -> None:
    """Refuse a place where no file can be made, such as /proc, where filelock waits in vain."""
    file = lock_file(target)
    with suppress(FileExistsError):
        os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        file.unlink()


def _release(lock: FileLock, target: Path) -> None:
    # On Windows filelock removes the file; elsewhere it must be removed while it is locked, or a
    # process that has just locked it would lose it. A forked child does not hold the lock.
    if sys.platform != "win32" and lock.is_locked and lock.lock_counter == 1:
        lock_file(target).unlink(missing_ok=True)
    lock.release()


def _check_ours(path: Path) -> None:
    if not os.path.lexists(path) or path.is_symlink():
        return  # filelock refuses a link.
    if not path.is_file() or (path.stat().st_size and _read(path) is None):
        raise OutputError(
            f"{path}: is in the way of a lock and was not written by lightmatrix",
            hint="move it elsewhere, or choose another name for the output",
        )


def _sign(file: int) -> None:
    """Write into a lock file, just locked, who holds it."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "pid": os.getpid(),
        "host": platform.node(),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:500],
    }
    # The first byte is a blank, since Windows lets nobody else read the byte that is locked. A
    # full disk only costs the name of the owner here; the output itself will name the problem.
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.write(file, f" {json.dumps(content)}\n".encode())


def _read(path: Path) -> dict[str, object] | None:
    """What the owner of a lock file wrote into it; None if it is not ours."""
    try:
        with path.open("rb", buffering=0) as file:
            file.seek(1)
            content = json.loads(file.read(_MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and content.get("format") == FORMAT else None


def _refusal(target: Path) -> OutputError:
    content = _read(lock_file(target)) or {}
    owner = "another process"
    if content:
        owner = f"process {content.get('pid')} on {content.get('host')} since "
        owner = printable(f"{owner}{content.get('since')} ({content.get('command')})")
    return OutputError(
        f"{target}: is being written by {owner}",
        hint="wait for it to end, or choose another name for the output",
    )
