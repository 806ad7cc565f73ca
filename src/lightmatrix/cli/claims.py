"""The outputs of the command that runs: checked before any work, and locked until it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightmatrix.files.kinds import PARTIAL, OutputKind
from lightmatrix.files.writing import claimed

# `lightmatrix.cli.app` closes them when the command ends.
outputs = ExitStack()


def claim(output: Path, kind: OutputKind, *, overwrite: bool, parts: str = "") -> Path:
    """Check an output and hold its lock until the command ends; returns where it is written.

    With `parts`, such as "tiles", an error of the command says which of them are kept.
    """
    if parts:
        outputs.enter_context(_saying_what_is_kept(output, parts))
    return outputs.enter_context(claimed(output, kind, overwrite=overwrite))


@contextmanager
def _saying_what_is_kept(output: Path, parts: str) -> Iterator[None]:
    before = _file_number(output)
    try:
        yield
    except BaseException as error:
        if _file_number(output) != before:
            error.add_note(f"{output} is finished")
        elif output.with_name(output.name + PARTIAL).exists():
            error.add_note(f"finished {parts} are kept, run again to continue")
        raise


def _file_number(place: Path) -> int | None:
    """The inode of an output, which changes when it is replaced; None if there is none."""
    try:
        return place.stat().st_ino
    except OSError:
        return None
