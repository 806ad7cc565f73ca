"""`lightmatrix check`: what is wrong with a capture."""

from __future__ import annotations

import typer

from lightmatrix.cli.options import Json
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import as_options, say, show_json


@with_source()
def check(*, source: Source, as_json: Json = False) -> None:
    """Find what is wrong with a capture, and say what to do.

    Give a capture folder; or patterns and images, each as a folder or a stack. The command finds
    frames that are missing, late, swapped, black or odd; gamma and JPEG; motion and flicker; too
    much or too little light; and pixels that the patterns cannot tell apart. It exits with 0 if
    nothing is wrong, and with 1 otherwise. Stripes are a note, not a fault.
    """
    findings = source.check()
    if as_json:
        show_json({"findings": [finding.as_dict() for finding in findings]})
    elif findings:
        for finding in findings:
            say(as_options(f"{finding.kind}: {finding.message}"), style="yellow")
            say(as_options(f"  {finding.advice}"))
    else:
        say("nothing is wrong")
    if not all(finding.is_note for finding in findings):
        raise typer.Exit(1)
