"""The outputs of the command that runs: judged before any work, and locked until it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightmatrix.cli.stops import is_stop
from lightmatrix.cli.terminal import Stopped
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


def tell_when_stopped(output: Path, parts: str) -> None:
    """On Ctrl-C, from now until the command ends, say what is left of an output made in parts."""
    outputs.enter_context(_told_when_stopped(output, parts))


@contextmanager
def _told_when_stopped(output: Path, parts: str) -> Iterator[None]:
    before = _identity(output)
    try:
        yield
    except BaseException as error:
        # Libraries may have made their own of it.
        if not is_stop(error):
            raise
        kept = output.with_name(output.name + PARTIAL).exists()
        left = f"finished {parts} are kept, run again to go on" if kept else ""
        if _identity(output) != before:
            left = f"{output} is finished"
        told = [str(error)] if isinstance(error, Stopped) else []
        raise Stopped("; ".join(filter(None, [left, *told]))) from None


def _identity(place: Path) -> int | None:
    try:
        return place.stat().st_ino
    except OSError:
        return None
