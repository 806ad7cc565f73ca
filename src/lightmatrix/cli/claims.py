"""The outputs of the command that runs: checked before any work, and locked until it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightmatrix.cli.failures import lacks_memory
from lightmatrix.cli.stops import is_stop
from lightmatrix.cli.terminal import FinishedError, Stopped
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import PARTIAL, OutputKind
from lightmatrix.outputs.writing import claimed

# `lightmatrix.cli.app` closes them when the command ends.
outputs = ExitStack()


def claim(output: Path, kind: OutputKind, *, overwrite: bool) -> Path:
    """Check an output and hold its lock until the command ends; returns where it is written."""
    return outputs.enter_context(claimed(output, kind, overwrite=overwrite))


def say_what_is_kept(output: Path, parts: str, *, enough: bool = False) -> None:
    """From now until the command ends, let a failure say what is kept of an output.

    With `enough`, the finished output is all that the command had to do: this is no failure.
    """
    outputs.enter_context(_saying_what_is_kept(output, parts, enough))


@contextmanager
def _saying_what_is_kept(output: Path, parts: str, enough: bool) -> Iterator[None]:
    before = _file_number(output)
    try:
        yield
    except BaseException as error:
        finished = _file_number(output) != before
        if is_stop(error):
            words = [f"finished {parts} are kept, run again to continue"]
            if finished:
                words = [f"{output} is finished"]
            elif not output.with_name(output.name + PARTIAL).exists():
                words = []
            if isinstance(error, Stopped):
                words.append(str(error))
            raise Stopped("; ".join(filter(None, words))) from None
        if finished and lacks_memory(error):
            why = "then there was not enough memory"
        elif finished and enough and isinstance(error, InputError):
            # The whole output could not be read back.
            why = error.message
        else:
            raise
        raise FinishedError(f"{output} is finished; {why}", enough) from error


def _file_number(place: Path) -> int | None:
    """The inode of an output, which changes when it is replaced; None if there is none."""
    try:
        return place.stat().st_ino
    except OSError:
        return None
