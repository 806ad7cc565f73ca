"""From an exception to one message on standard error and an exit code."""

from __future__ import annotations

import errno
import os
import re
import sys
import traceback
from contextlib import suppress
from difflib import get_close_matches
from typing import TextIO

import typer

from lightmatrix.cli.stops import is_stop
from lightmatrix.cli.terminal import FinishedError, Stopped, warn
from lightmatrix.errors import LightMatrixError

BAD, NO_MEMORY, BUG, STOPPED = 2, 3, 70, 130
# Set to anything, it shows where a bug happened.
DEBUG = "LIGHTMATRIX_DEBUG"
_STREAM_ERRORS = {errno.ENOSPC, errno.EIO, errno.EBADF, errno.EDQUOT, errno.EFBIG}


def report(error: BaseException) -> int:
    """Say what went wrong, in one message.

    Returns
    -------
    int
        The exit code.
    """
    if isinstance(error, BrokenPipeError):
        # Whoever read, as `head` does, has read enough.
        _give_up(sys.stdout)
        return 0
    code, lines = _explain(error)
    try:
        for number, line in enumerate(lines):
            warn(line if number == 0 else f"  {line}", "red" if number == 0 and code else None)
    except (OSError, ValueError):
        # Where standard error is gone too, the code is all there is to tell; and what it still
        # holds must not make Python, on leaving, tell another.
        _give_up(sys.stderr)
    return code


def lacks_memory(error: BaseException) -> bool:
    """Whether it is for want of memory, of which a thread takes some too."""
    return isinstance(error, MemoryError) or "can't start new thread" in str(error)


def _explain(error: BaseException) -> tuple[int, list[str]]:
    if is_stop(error):
        note = str(error) if isinstance(error, Stopped) else ""
        return STOPPED, [f"stopped; {note}" if note else "stopped"]
    if isinstance(error, LightMatrixError):
        return BAD, [f"error: {error.message}", *([error.hint] if error.hint else [])]
    if isinstance(error, typer.TyperException):
        message, hint = _usage_error(error)
        return BAD, [f"error: {message}", hint]
    if isinstance(error, FinishedError):
        code, what = (0, str(error)) if error.enough else (NO_MEMORY, f"error: {error}")
        return code, [what, "look at it with `lightmatrix info`"]
    if lacks_memory(error):
        return NO_MEMORY, ["error: not enough memory", "use a smaller size or --tile-rows"]
    if isinstance(error, OSError) and str(error).startswith("cannot start"):
        return NO_MEMORY, [f"error: {error}", "free some memory, or set RAYON_NUM_THREADS to fewer"]
    if isinstance(error, OSError) and error.filename is None and error.errno in _STREAM_ERRORS:
        _give_up(sys.stdout)
        why = error.strerror or str(error)
        hint = "free some space, or send what is printed elsewhere"
        return BAD, [f"error: standard output cannot be written ({why})", hint]
    if isinstance(error, OSError) and error.filename is not None:
        hint = "check the name, its permissions and the free space"
        return BAD, [f"error: {error.filename}: {error.strerror or error}", hint]
    if os.environ.get(DEBUG):
        with suppress(OSError, ValueError):
            traceback.print_exception(error)
    told = " ".join(str(error).split())
    return BUG, [
        f"internal error: {type(error).__name__}: {told}",
        f"this is a bug of lightmatrix: please report it with the command; {DEBUG}=1 shows where",
    ]


def _usage_error(error: typer.TyperException) -> tuple[str, str]:
    """What was wrong with the words given, and where to look or what was probably meant."""
    message = error.format_message().replace("Value error, ", "")
    context = getattr(error, "ctx", None)
    hint = f"see `{context.command_path if context else 'lightmatrix'} --help`"
    choice = re.search(r"'([^']*)' is not one of (.*)", message)
    if choice:
        near = get_close_matches(choice[1], re.findall(r"'([^']*)'", choice[2]), n=1)
        hint = f"did you mean {near[0]}? {hint}" if near else hint
    return message, hint


def _give_up(stream: TextIO) -> None:
    """Let what is still to be written vanish, lest Python complains about it on leaving."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
