"""Runs a command of lightmatrix in a process of its own, forked off one that is warm.

The warm process is that of `multiprocessing`'s fork server: everything is imported there once, it
has no threads, and a command that crashes hurts nobody else.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import multiprocessing
import multiprocessing.connection
import os
import shlex
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

if sys.platform != "win32":
    import resource

    SERVER = multiprocessing.get_context("forkserver")

# Seconds after which a command hangs, by the clock, and by the processor's time. None needs a tenth
# of that; a busy machine is no reason to fail.
HANG, PROCESSOR = 120.0, 40
# Exit code of a child that let an exception out, or that could not be given its limits.
_ESCAPED, _SKIPPED = 99, 98


class SkipError(Exception):
    """The system cannot make this fault, with the reason."""


@dataclass(frozen=True)
class Ran:
    """What a command did: exit code (negative for a signal, None for a hang) and words."""

    code: int | None
    out: str = ""
    err: str = ""


@dataclass(frozen=True)
class Limits:
    """What the system gives a command.

    Parameters
    ----------
    memory : int, optional
        Bytes of address space beyond what the interpreter already has.
    file_size : int, optional
        Bytes that a file may grow to, as a full disk would have it.
    mount : (str, int), optional
        A folder of the work folder that becomes a small disk of its own, and its bytes.
    environment : tuple of (str, str)
        Variables set.
    """

    memory: int | None = None
    file_size: int | None = None
    mount: tuple[str, int] | None = None
    environment: tuple[tuple[str, str], ...] = ()


class Command:
    """A command line that runs in a folder; `pid` is that of its process."""

    def __init__(self, words: str, folder: Path, limits: Limits | None = None) -> None:
        # Pipes, since limits on the size of files would hold for files of words too.
        (self._out, out), (self._err, err) = SERVER.Pipe(False), SERVER.Pipe(False)
        arguments = (shlex.split(words), str(folder), out, err, limits or Limits())
        self._process = SERVER.Process(target=_child, args=arguments)
        self._process.start()
        out.close()
        err.close()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def ended(self) -> bool:
        """Whether it is over."""
        return not self._process.is_alive()

    def wait(self, seconds: float = HANG) -> Ran:
        """What it did; killed if it is not over after so many seconds."""
        end = time.monotonic() + seconds
        words = {self._out: b"", self._err: b""}
        waiting = [self._out, self._err]
        while waiting and time.monotonic() < end:
            for stream in multiprocessing.connection.wait(waiting, 1.0):
                assert isinstance(stream, Connection)
                piece = os.read(stream.fileno(), 1 << 16)
                words[stream] += piece
                if not piece:
                    waiting.remove(stream)
        self._process.join(max(0.1, end - time.monotonic()))
        code = self._process.exitcode
        self.kill()
        out, err = (words[stream].decode("utf-8", "replace") for stream in (self._out, self._err))
        if code == _SKIPPED:
            raise SkipError(err)
        return Ran(code, out, err)

    def kill(self) -> None:
        """End it if it is not over."""
        if not self.ended():
            self._process.kill()
        self._process.join()
        self._out.close()
        self._err.close()


def run(words: str, folder: Path, limits: Limits | None = None) -> Ran:
    """Run one command line of lightmatrix, split as a shell does, in a folder.

    Raises
    ------
    SkipError
        If the system cannot give the limits.
    """
    return Command(words, folder, limits).wait()


def _child(argv: list[str], folder: str, out: Connection, err: Connection, limits: Limits) -> None:
    code = _ESCAPED
    try:
        # As in a program of its own; with the server's method, locks would be left to be tidied up.
        multiprocessing.set_start_method("fork", force=True)
        os.chdir(folder)
        null = os.open(os.devnull, os.O_RDONLY)
        for source, target in ((null, 0), (out.fileno(), 1), (err.fileno(), 2)):
            os.dup2(source, target)
        out.close()
        err.close()
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout = io.TextIOWrapper(open(1, "wb", closefd=False), "utf-8")  # noqa: SIM115
        sys.stderr = io.TextIOWrapper(
            open(2, "wb", closefd=False),  # noqa: SIM115
            "utf-8",
            errors="backslashreplace",
            line_buffering=True,
        )
        # A shell's background ignores Ctrl-C, and what it starts inherits that. Writing beyond the
        # limit of a file must fail, as on a full disk, and not kill.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        tempfile.tempdir = None
        os.environ.update(limits.environment, TMPDIR=str(Path(folder).parents[1] / "tmp"))
        _limit(limits, Path(folder))
        from lightmatrix.cli import main, stop_when_terminated

        stop_when_terminated()

        code = main(argv)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else int(left.code is not None)
    except SkipError as reason:
        code = _SKIPPED
        sys.stderr.write(str(reason))
    except BaseException:
        with contextlib.suppress(BaseException):
            traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(BaseException):
            stream.flush()
    os._exit(code & 0xFF)


def _limit(limits: Limits, folder: Path) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR, PROCESSOR))
    if limits.mount is not None:
        _mount_small_disk(folder / limits.mount[0], limits.mount[1])
    if limits.file_size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_size, limits.file_size))
    if limits.memory is not None:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + limits.memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _mount_small_disk(folder: Path, size: int) -> None:
    """A disk that only this process sees, and that goes when it ends."""
    new_users, new_mounts, private = 0x10000000, 0x00020000, 0x40000 | 0x4000
    library = ctypes.CDLL(None, use_errno=True)
    flags = new_mounts if os.geteuid() == 0 else new_mounts | new_users
    made = library.unshare(flags) == 0
    made = made and library.mount(None, b"/", None, private, None) == 0
    options = f"size={size}".encode()
    if not made or library.mount(b"none", os.fsencode(folder), b"tmpfs", 0, options) != 0:
        raise SkipError(f"no right to mount a disk ({os.strerror(ctypes.get_errno())})")
