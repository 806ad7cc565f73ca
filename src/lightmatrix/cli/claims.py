"""The outputs of the command that runs: judged before any work, and locked until it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightmatrix.cli.failures import lacks_memory
from lightmatrix.cli.stops import is_stop
from lightmatrix.cli.terminal import FinishedError, Stopped
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import PARTIAL
from lightmatrix.outputs.markers import OutputKind
from lightmatrix.outputs.writing import claimed

# Closed by `lightmatrix.cli.app` when the command ends.
outputs = ExitStack()


def claim(output: Path, kind: OutputKind, *, overwrite: bool) -> Path:
    """Check an output before any work, and hold its lock until the command ends.

    Returns
    -------
    Path
        Where it will be written: links are followed to their end.
    """
    return outputs.enter_context(claimed(output, kind, overwrite=overwrite))


def tell_what_is_left(output: Path, parts: str, *, enough: bool = False) -> None:
    """From now until the command ends, say on Ctrl-C what is left of an output made in parts.

    So it is said where memory ends once the output is whole, which is no failure if the output is
    `enough`, all that was asked for.
    """
    outputs.enter_context(_left_told(output, parts, enough))


@contextmanager
def _left_told(output: Path, parts: str, enough: bool) -> Iterator[None]:
    before = _identity(output)
    try:
        yield
    except BaseException as error:
        # Libraries may have made their own of it.
        if not is_stop(error):
            if _identity(output) != before:
                _tell_finished(output, enough, error)
            raise
        kept = output.with_name(output.name + PARTIAL).exists()
        left = f"finished {parts} are kept, run again to go on" if kept else ""
        if _identity(output) != before:
            left = f"{output} is finished"
        told = [str(error)] if isinstance(error, Stopped) else []
        raise Stopped("; ".join(filter(None, [left, *told]))) from None


def _tell_finished(output: Path, enough: bool, error: BaseException) -> None:
    """Raise `FinishedError` where memory ended, or a whole output could not be read back."""
    if lacks_memory(error):
        why = "then there was not enough memory"
    elif enough and isinstance(error, InputError):
        why = error.message
    else:
        return
    raise FinishedError(f"{output} is finished; {why}", enough) from error


def _identity(place: Path) -> int | None:
    try:
        return place.stat().st_ino
    except OSError:
        return None
