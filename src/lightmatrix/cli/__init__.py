"""The command line: each command parses its arguments, calls one public function, and prints.

This file holds only the entry point and imports nothing heavy, so that Ctrl-C works from the first
moment. `main` imports the rest.
"""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys

from lightmatrix.resources.allocator import keep_freed_memory

# Bytes of address space below which NumPy and SciPy cannot be loaded: measured with `ulimit -v` on
# two cores, where 300 MB are too little and 400 MB are enough.
LEAST_ADDRESS_SPACE = 380 << 20

# New objects after which Python looks for garbage. Loading libraries makes hundreds of thousands
# that stay; with Python's own 700 this took .07 s. Commands make little garbage.
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
        code = 3
        if not _lacks_address_space():
            _load()
            code = main()
    except KeyboardInterrupt:
        code = 130
    # Python would look for garbage once more, for .15 s, in memory that the system frees anyway.
    gc.freeze()
    sys.exit(code)


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


def _lacks_address_space() -> bool:
    """Whether the system gives too little address space to load the libraries; says so.

    OpenBLAS would try again for ever.
    """
    if sys.platform == "win32":
        return False
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY or limit >= LEAST_ADDRESS_SPACE:
        return False
    sys.stderr.write(
        f"error: not enough memory: {limit >> 20} MiB of address space are allowed, "
        f"{LEAST_ADDRESS_SPACE >> 20} MiB are the least\n  raise the limit: ulimit -v unlimited\n"
    )
    return True


def _open_standard_streams() -> None:
    """Open the null device for closed streams, whose numbers our files would get otherwise."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # It stays open as long as the program runs.
            stream = open(os.devnull, "r" if number == 0 else "w")  # noqa: SIM115
            setattr(sys, name, stream)
