"""The command line: each command parses its arguments, calls one public function, and prints.

This file holds only the entry point and imports nothing heavy, so that Ctrl-C works from the first
moment. `main` imports the rest.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

# New objects after which Python looks for garbage. Loading libraries makes hundreds of thousands
# that stay; with Python's own 700 this took 0.07 s. Commands make little garbage.
NEW_OBJECTS = 10_000
# The power of two of the processor cycles after which an idle thread of OpenBLAS sleeps: 2^16 are
# some 20 microseconds. With its own 2^26 it spins for 20 ms after each product, which took 3 to 4 %
# of the processor time of an estimate of 128 x 128 pixels.
IDLE_CYCLES = "16"


def main(argv: list[str] | None = None) -> int:
    """Run the command line; None takes the words of the process.

    Returns 0 for done, 1 if `check` found a fault, 2 for bad input or output, 3 out of memory, 70
    for a bug of lightmatrix, 130 for Ctrl-C. All but 0 and 1 come with one message on standard
    error.
    """
    try:
        # Imported here, because the import takes long enough for a Ctrl-C.
        from lightmatrix.cli.app import run

        return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


def console() -> None:
    """Entry point of the installed command."""
    try:
        _open_standard_streams()
        keep_freed_memory()
        gc.set_threshold(NEW_OBJECTS)
        os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", IDLE_CYCLES)
        _load()
        stop_when_terminated()
        sys.unraisablehook = _stop_again
        code = main()
    except KeyboardInterrupt:
        code = 130
    # Python would look for garbage once more, for 0.15 s, in memory that the system frees anyway.
    gc.freeze()
    sys.exit(code)


def stop_when_terminated() -> None:
    """Let SIGTERM end a command like Ctrl-C: what it has begun to write is removed."""
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)


def _stop_again(lost: UnraisableHookArgs) -> None:
    """Send a signal again whose KeyboardInterrupt was raised in a finalizer, where Python drops it.

    It comes a moment later, when the finalizer is over.
    """
    if lost.exc_type is KeyboardInterrupt:
        threading.Timer(0.01, os.kill, [os.getpid(), signal.SIGTERM]).start()
    else:
        sys.__unraisablehook__(lost)


def keep_freed_memory() -> None:
    """Let this process use the memory of freed arrays again; call it before NumPy is loaded.

    Otherwise each large array of a tile is mapped anew, and the system fills its pages with zeros.
    That took two thirds of the system's time of an estimate of 256 x 256 pixels of both. Threads
    share a heap for each core, so that they keep no more memory than without this. Does nothing
    where the C library is another one.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    # The first arguments are M_MMAP_THRESHOLD, M_TRIM_THRESHOLD and M_ARENA_MAX of malloc.h. Blocks
    # of up to 128 MiB come from the heap, which is more than most arrays of a tile; older libraries
    # accept 32 MiB at most, and return 0 for more.
    any(mallopt(-3, size) for size in (128 << 20, 32 << 20))
    # A few arrays of a tile stay at the end of the heap.
    mallopt(-1, 256 << 20)
    mallopt(-8, max(2, os.cpu_count() or 1))


def _load() -> None:
    """Load the commands; a Ctrl-C meanwhile ends the process at once, for nothing is written yet.

    Python's own handler raises KeyboardInterrupt, which callbacks of the import system lose one
    time in a hundred. Ignored interrupts, as in background jobs of a shell, stay ignored.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if usual:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    importlib.import_module("lightmatrix.cli.app")
    if usual:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _open_standard_streams() -> None:
    """Open the null device for closed streams, whose numbers our files would get otherwise."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # It stays open as long as the program runs.
            stream = open(os.devnull, "r" if number == 0 else "w")  # noqa: SIM115
            setattr(sys, name, stream)
