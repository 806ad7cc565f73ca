"""The command line: parse, call one function of the door, show.

This file holds the entry point alone and loads nothing, so that Ctrl-C finds it from the first
moment on; all else is loaded by `main`.
"""

from __future__ import annotations

import os
import sys


def main(argv: list[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        The words after `lightmatrix`; None takes those of the process.

    Returns
    -------
    int
        0; 2 on bad input or output and 3 where memory ran out, both with one message on standard
        error; 70 on a bug of ours; 130 on Ctrl-C.
    """
    try:
        # Inside, because this takes long enough for a Ctrl-C.
        from lightmatrix.cli.stops import quiet_stops

        with quiet_stops():
            from lightmatrix.cli.app import run

            return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


def console() -> None:
    """Entry point of the installed command."""
    try:
        _open_standard_streams()
        code = main()
    except KeyboardInterrupt:
        code = 130
    sys.exit(code)


def _open_standard_streams() -> None:
    """Put something in place of streams that were closed, lest a file of ours takes their number.

    Python has None for them, which cannot be written to.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # Open as long as the program runs.
            stream = open(os.devnull, "r" if number == 0 else "w")  # noqa: SIM115
            setattr(sys, name, stream)
