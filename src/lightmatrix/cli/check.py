"""`lightmatrix check`: what is wrong with a capture, before anything is estimated from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from lightmatrix.cli.options import Json
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import say, show_json

if TYPE_CHECKING:
    from lightmatrix import Finding

# What `check` exits with if it finds something.
FOUND = 1


@with_source()
def check(
    *,
    source: Source,
    as_json: Json = False,
) -> None:
    """Tell what is wrong with a capture, and what to do.

    Give a capture folder; or patterns and images, each a folder or a stack. Frames lost, late,
    swapped, black or odd; gamma and JPEG; motion and flicker; light; what the patterns cannot
    tell. Exits with 0 if nothing is found, with 1 if something is.
    """
    findings = source.check()
    if as_json:
        show_json({"findings": [finding.as_dict() for finding in findings]})
    elif findings:
        show_findings(findings)
    else:
        say("nothing wrong was found")
    if findings:
        raise typer.Exit(FOUND)


def show_findings(findings: list[Finding]) -> None:
    """Print findings, each with what to do."""
    for finding in findings:
        say(f"{finding.kind}: {finding.message}", style="yellow")
        say(f"  {finding.advice}")
