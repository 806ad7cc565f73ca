"""The outputs of the command that runs: checked before any work, and locked until it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import PARTIAL, OutputKind
from lightmatrix.files.writing import claimed

# `lightmatrix.cli.app` closes them when the command ends.
outputs = ExitStack()


class FinishedError(Exception):
    """The output is complete (all of it if `enough`), but memory ended in describing it."""

    def __init__(self, message: str, enough: bool) -> None:
        super().__init__(message)
        self.enough = enough


def claim(output: Path, kind: OutputKind, *, overwrite: bool) -> Path:
    """Check an output and hold its lock until the command ends; returns where it is written."""
    return outputs.enter_context(claimed(output, kind, overwrite=overwrite))


def say_what_is_kept(output: Path, parts: str, *, enough: bool = False) -> None:
    """From now until the command ends, let a failure say what is kept of an output.

    With `enough`, the finished output is all that the command had to do: this is no failure.
    """
    outputs.enter_context(_saying_what_is_kept(output, parts, enough))


def is_stop(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C, which libraries may have turned into one of theirs."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def lacks_memory(error: BaseException) -> bool:
    """Whether memory ran out: for objects, a thread that starts, or a library that is loaded."""
    words = str(error)
    # What Linux says of a library that finds no room in memory.
    signs = ("failed to map segment", "annot allocate memory", "cannot map zero-fill")
    loading = isinstance(error, ImportError) and any(sign in words for sign in signs)
    return isinstance(error, MemoryError) or loading or "can't start new thread" in words


@contextmanager
def _saying_what_is_kept(output: Path, parts: str, enough: bool) -> Iterator[None]:
    before = _file_number(output)
    try:
        yield
    except BaseException as error:
        finished = _file_number(output) != before
        if is_stop(error) and finished:
            error.add_note(f"{output} is finished")
        elif is_stop(error) and output.with_name(output.name + PARTIAL).exists():
            error.add_note(f"finished {parts} are kept, run again to continue")
        elif finished and lacks_memory(error):
            why = "then there was not enough memory"
            raise FinishedError(f"{output} is finished; {why}", enough) from error
        elif finished and enough and isinstance(error, InputError):
            # The whole output could not be read back.
            raise FinishedError(f"{output} is finished; {error.message}", enough) from error
        raise


def _file_number(place: Path) -> int | None:
    """The inode of an output, which changes when it is replaced; None if there is none."""
    try:
        return place.stat().st_ino
    except OSError:
        return None
