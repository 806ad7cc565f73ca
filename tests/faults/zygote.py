"""Runs commands in forked processes: everything is imported once, and a crash hurts no one else.

Started by `workers.Worker`; takes one JSON request a line and answers with one JSON line.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import select
import shlex
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from .case import Limits, Ran, SkipError

if sys.platform != "win32":
    import resource

# Exit code of a child that let an exception out.
_ESCAPED = 99
_MOST_WORDS = 200_000


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
    # Pipes, since limits on the size of files would hold for files of words too.
    (out, to_out), (err, to_err) = os.pipe(), os.pipe()
    started = time.perf_counter()
    child = os.fork()
    if child == 0:
        _child(argv, folder, to_out, to_err, limits or Limits(), before)
    os.close(to_out)
    os.close(to_err)
    try:
        code, words_out, words_err = _wait(child, seconds, out, err)
    finally:
        os.close(out)
        os.close(err)
    passed = time.perf_counter() - started
    if code == _ESCAPED and words_err.startswith("skip: "):
        raise SkipError(words_err.removeprefix("skip: ").strip())
    return Ran(code, words_out, words_err, passed)


def _wait(child: int, seconds: float, out: int, err: int) -> tuple[int | None, str, str]:
    """The exit code, negative for a signal, None if it had to be killed; and the words."""
    end = time.monotonic() + seconds
    words: dict[int, list[bytes]] = {out: [], err: []}
    open_ends = {out, err}
    code: int | None = None
    ended = False
    while True:
        patience = 0 if ended else 0.02 if open_ends else 0.001
        ready, _, _ = select.select(list(open_ends), [], [], patience)
        for stream in ready:
            piece = os.read(stream, 1 << 16)
            if not piece:
                open_ends.discard(stream)
            elif sum(map(len, words[stream])) < _MOST_WORDS:
                words[stream].append(piece)
        if ready and time.monotonic() < end:
            continue
        if ended:
            break
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            # What it wrote just before it ended, after `select` had looked, is still to be read.
            code, ended = os.waitstatus_to_exitcode(status), True
        elif time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            break
    words_out, words_err = (
        b"".join(words[stream]).decode("utf-8", "replace") for stream in (out, err)
    )
    return code, words_out, words_err


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
