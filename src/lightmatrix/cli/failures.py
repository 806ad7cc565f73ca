"""Turns an exception into one message on standard error and an exit code."""

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

# Exit codes. 70 is EX_SOFTWARE of sysexits.h, and 130 what shells give for Ctrl-C.
BAD, NO_MEMORY, BUG, STOPPED = 2, 3, 70, 130
# What Linux says of a library that finds no room in memory.
_NO_ROOM_FOR_LIBRARY = ("failed to map segment", "annot allocate memory", "cannot map zero-fill")
# Variables that our libraries read when pictures are drawn, and that they refuse by a ValueError.
_VARIABLES_OF_LIBRARIES = ("MPLBACKEND", "SOURCE_DATE_EPOCH")
# If this variable is set, a bug prints its traceback.
DEBUG = "LIGHTMATRIX_DEBUG"
# Errors of a stream, such as a full disk behind standard output, that are no bug.
_STREAM_ERRORS = {errno.ENOSPC, errno.EIO, errno.EBADF, errno.EDQUOT, errno.EFBIG}


def report(error: BaseException) -> int:
    """Print what went wrong as one message, and return the exit code."""
    if isinstance(error, BrokenPipeError):
        # The reader, such as `head`, has read enough.
        _give_up(sys.stdout)
        return 0
    code, lines = _explain(error)
    try:
        for number, line in enumerate(map(as_options, lines)):
            warn(line if number == 0 else f"  {line}", "red" if number == 0 and code else None)
    except (OSError, ValueError):
        # Without standard error only the exit code is left. Python must not try to write the rest
        # of its buffer when it exits.
        _give_up(sys.stderr)
    return code


def as_options(text: str) -> str:
    """The text with each parameter of a function, such as overwrite=True, as the option it is."""

    def option(match: re.Match[str]) -> str:
        name, value = match[1].replace("_", "-"), match[2].strip("\"'")
        return {"True": f"--{name}", "False": f"--no-{name}"}.get(value, f"--{name} {value}")

    # What is no parameter has blanks around =, or other characters.
    return re.sub(r"""(?<![\w/.-])([a-z]+(?:_[a-z]+)*)=("[^"]*"|\w[\w.,:/]*\w|\w)""", option, text)


def lacks_memory(error: BaseException) -> bool:
    """Whether memory ran out: for objects, a thread that starts, or a library that is loaded."""
    words = str(error)
    loading = isinstance(error, ImportError) and any(why in words for why in _NO_ROOM_FOR_LIBRARY)
    return isinstance(error, MemoryError) or loading or "can't start new thread" in words


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
        return code, [what, "`lightmatrix info` shows it"]
    if lacks_memory(error):
        return NO_MEMORY, [
            "error: not enough memory",
            "use a smaller size, --memory or --tile-rows",
        ]
    if isinstance(error, OSError) and str(error).startswith("cannot start"):
        return NO_MEMORY, [f"error: {error}", "free some memory, or lower RAYON_NUM_THREADS"]
    if isinstance(error, OSError) and error.filename is None and error.errno in _STREAM_ERRORS:
        _give_up(sys.stdout)
        why = error.strerror or str(error)
        hint = "free some space, or redirect the output elsewhere"
        return BAD, [f"error: standard output cannot be written ({why})", hint]
    if isinstance(error, OSError) and error.filename is not None:
        hint = "check the name, its permissions and the free space"
        return BAD, [f"error: {error.filename}: {error.strerror or error}", hint]
    for name in _VARIABLES_OF_LIBRARIES if isinstance(error, ValueError) else ():
        if os.environ.get(name) and repr(os.environ[name]) in str(error):
            message = f"the environment variable {name} cannot be {os.environ[name]!r}"
            return BAD, [f"error: {message}", f"unset {name}, which lightmatrix does not need"]
    if os.environ.get(DEBUG):
        with suppress(OSError, ValueError):
            traceback.print_exception(error)
    text = " ".join(str(error).split())
    return BUG, [
        f"internal error: {type(error).__name__}: {text}",
        f"this is a bug of lightmatrix; please report it with the command and with {DEBUG}=1 set",
    ]


def _usage_error(error: typer.TyperException) -> tuple[str, str]:
    """What is wrong with the arguments; and what the user probably meant, or where to look."""
    message = error.format_message().replace("Value error, ", "")
    context = getattr(error, "ctx", None)
    hint = f"see `{context.command_path if context else 'lightmatrix'} --help`"
    choice = re.search(r"'([^']*)' is not one of (.*)", message)
    if choice:
        near = get_close_matches(choice[1], re.findall(r"'([^']*)'", choice[2]), n=1)
        hint = f"did you mean {near[0]}? {hint}" if near else hint
    return message, hint


def _give_up(stream: TextIO) -> None:
    """Drop what the stream still holds, so that Python does not complain when it exits."""
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
