"""The outputs of the command that runs: judged before any work, and locked until it ends."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

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
