"""Runs commands in forked processes: everything is imported once, and a crash hurts no one else.

Started by `workers.Worker`; takes one JSON request a line and answers with one JSON line.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import resource
import shlex
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from .case import Limits, Ran, SkipError

# Exit code of a child that let an exception out.
_ESCAPED = 99
_MOST_WORDS = 200_000
# Where our own temporary files lie; those of commands have a folder a case.
_WORDS = tempfile.gettempdir()


def run_command(
    words: list[str] | str,
    folder: Path,
    *,
    limits: Limits | None = None,
    seconds: float = 20.0,
    before: Callable[[], None] | None = None,
) -> Ran:
    """Run one command line of lightmatrix in a forked process, in a folder.

    Parameters
    ----------
    words : list of str or str
        The command after `lightmatrix`; a str is split as a shell does.
    folder : Path
        Where it runs.
    limits, seconds : Limits, float
        What it gets.
    before : callable, optional
        Called in the process before the command.

    Raises
    ------
    SkipError
        If the system cannot give the limits.
    """
    argv = shlex.split(words) if isinstance(words, str) else words
    with tempfile.TemporaryFile(dir=_WORDS) as out, tempfile.TemporaryFile(dir=_WORDS) as err:
        started = time.perf_counter()
        child = os.fork()
        if child == 0:
            _child(argv, folder, out.fileno(), err.fileno(), limits or Limits(), before)
        code = _wait(child, seconds)
        passed = time.perf_counter() - started
        for stream in (out, err):
            stream.seek(0)
        said = out.read(_MOST_WORDS).decode("utf-8", "replace")
        words_err = err.read(_MOST_WORDS).decode("utf-8", "replace")
    if code == _ESCAPED and words_err.startswith("skip: "):
        raise SkipError(words_err.removeprefix("skip: ").strip())
    return Ran(code, said, words_err, passed)


def _wait(child: int, seconds: float) -> int | None:
    """The exit code, negative for a signal; None if it had to be killed."""
    end = time.monotonic() + seconds
    pause = 0.001
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(pause)
        pause = min(0.02, pause * 1.5)


def _child(
    argv: list[str],
    folder: Path,
    out: int,
    err: int,
    limits: Limits,
    before: Callable[[], None] | None,
) -> None:
    code = _ESCAPED
    try:
        os.chdir(folder)
        tempfile.tempdir = None
        null = os.open(os.devnull, os.O_RDONLY)
        for source, target in ((null, 0), (out, 1), (err, 2)):
            os.dup2(source, target)
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout = io.TextIOWrapper(open(1, "wb", closefd=False), "utf-8")  # noqa: SIM115
        sys.stderr = io.TextIOWrapper(
            open(2, "wb", closefd=False),  # noqa: SIM115
            "utf-8",
            errors="backslashreplace",
            line_buffering=True,
        )
        signal.signal(signal.SIGINT, signal.default_int_handler)
        # Writing beyond the limit of a file then fails, as on a full disk, and does not kill.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        try:
            _limit(limits, folder)
            if before is not None:
                before()
        except SkipError as reason:
            sys.stderr.write(f"skip: {reason}")
        else:
            code = _main(argv)
        sys.stdout.flush()
    except BaseException:
        code = _ESCAPED
        with contextlib.suppress(BaseException):
            traceback.print_exc()
    finally:
        with contextlib.suppress(BaseException):
            sys.stderr.flush()
        os._exit(code & 0xFF)


def _main(argv: list[str]) -> int:
    from lightmatrix.cli import main

    try:
        return main(argv)
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)


def _limit(limits: Limits, folder: Path) -> None:
    for name, value in limits.environment:
        os.environ[name] = value
    if limits.mount is not None:
        _mount_small_disk(folder / limits.mount[0], limits.mount[1])
    if limits.file_size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_size, limits.file_size))
    if limits.memory is not None:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + limits.memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


_NEW_USERS, _NEW_MOUNTS = 0x10000000, 0x00020000
_PRIVATE = 0x40000 | 0x4000


def _mount_small_disk(folder: Path, size: int) -> None:
    """A disk that only this process sees, and that goes when it ends."""
    library = ctypes.CDLL(None, use_errno=True)
    flags = _NEW_MOUNTS if os.geteuid() == 0 else _NEW_MOUNTS | _NEW_USERS
    made = library.unshare(flags) == 0
    made = made and library.mount(None, b"/", None, _PRIVATE, None) == 0
    options = f"size={size}".encode()
    if not made or library.mount(b"none", os.fsencode(folder), b"tmpfs", 0, options) != 0:
        raise SkipError(f"no right to mount a disk ({os.strerror(ctypes.get_errno())})")
